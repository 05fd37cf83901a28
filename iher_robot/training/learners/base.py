"""Run learner: learns one epoch at a time, wherever it computes; and the synchronous one."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

from drivers.closing import Closing
from iher_robot.config.run import RunConfig
from iher_robot.errors import UserError
from iher_robot.evaluation.success_rate import RunSeeds, evaluate_learner
from iher_robot.learning.episode import Episode
from iher_robot.learning.learner import Learner
from iher_robot.learning.progress import Progress
from iher_robot.training.epoch import EpochData, LearnedEpoch, Row
from iher_robot.training.recovery import Restored
from iher_robot.training.setup import TrainingSetup


class RunLearner(Closing):
    """Learns one epoch at a time.

    Attributes:
        learner: The learner after the last epoch that came back; it acts, and is evaluated.
        under_way: The epoch that is being learned, None if there is none.
    """

    def __init__(self, learner: Learner) -> None:
        self.learner = learner
        self.under_way: EpochData | None = None

    @abstractmethod
    def begin(self, restored: Restored) -> None:
        """Start as a new run, or from the state of a stopped one."""

    @abstractmethod
    def exchange(self, epoch: EpochData | None) -> LearnedEpoch | None:
        """Hand over an epoch, and take a learned one back.

        Args:
            epoch: The epoch; None if there is none.

        Returns:
            A synchronous learner returns the same epoch; an asynchronous one waits for the epoch
            before and returns it. None if there is none.

        Raises:
            UserError: The learner cannot go on.
        """

    @abstractmethod
    def look(self) -> None:
        """Switch to a newer policy between two episodes, if there is one.

        Raises:
            UserError: The learner cannot go on.
        """

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """State for a checkpoint, after the last epoch that came back."""


class SyncLearner(RunLearner):
    """Learns in this process, while the robot is held.

    Args:
        setup: Robot, simulator and learner.
        progress: Called with the progress of each phase.
    """

    def __init__(self, setup: TrainingSetup, progress: Progress) -> None:
        super().__init__(setup.learner)
        self._setup = setup
        self._progress = progress

    def begin(self, restored: Restored) -> None:
        """Start as a new run, or from the state of a stopped one."""
        if restored.learner is not None:
            self.learner.load_state_dict(restored.learner, restored.by_epoch)

    def exchange(self, epoch: EpochData | None) -> LearnedEpoch | None:
        """Learn an epoch."""
        if epoch is None:
            return None
        metrics = learn_epoch(
            self.learner,
            epoch.episodes,
            self._setup.config,
            self._setup.run_simulated if epoch.evaluate else None,
            self._progress,
        )
        return LearnedEpoch(epoch, metrics)

    def look(self) -> None:
        """Nothing changes between two episodes."""

    def state_dict(self) -> dict[str, Any]:
        """State for a checkpoint."""
        return self.learner.state_dict()

    def close(self) -> None:
        """Do nothing: it holds no resources."""


def learn_epoch(
    learner: Learner,
    episodes: Sequence[Episode],
    config: RunConfig,
    run_seeds: RunSeeds | None,
    progress: Progress,
) -> Row:
    """Learn from the real episodes of an epoch.

    Args:
        learner: The learner.
        episodes: The episodes.
        config: Settings of the run.
        run_seeds: Runs the episodes of an evaluation afterwards; None for no evaluation.
        progress: Called with the progress of each phase.

    Returns:
        Metrics of learning and of the evaluation.

    Raises:
        UserError: The models diverged.
    """
    learner.add_real(episodes)
    try:
        row = learner.learn(progress)
    except FloatingPointError as error:
        raise UserError(f"learning stopped in epoch {learner.epoch}: {error}") from error
    if run_seeds is not None:
        row |= evaluate_learner(
            learner,
            run_seeds,
            run_seed=config.seed,
            count=config.evaluation.episodes,
            progress=progress,
        )
    return row
