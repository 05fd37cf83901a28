"""The learner of a run, in turn with the robot or beside it."""

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
from iher_robot.training.epoch import EpochData, Learned, Row
from iher_robot.training.recovery import Restored
from iher_robot.training.setup import TrainingSetup


class RunLearner(Closing):
    """Learns an epoch at a time, wherever it computes.

    Attributes:
        learner: The learner as it is after the epoch that came back last; it acts, and is judged.
        under_way: What is being learned, None where nothing is.
    """

    def __init__(self, learner: Learner) -> None:
        self.learner = learner
        self.under_way: EpochData | None = None

    @abstractmethod
    def begin(self, restored: Restored) -> None:
        """Take over the state of a stopped run, or begin as a new one."""

    @abstractmethod
    def exchange(self, lesson: EpochData | None) -> Learned | None:
        """Hand over an epoch, and take one back.

        Args:
            lesson: The epoch; None where there is none.

        Returns:
            The same epoch where learning is in turn with the robot; else the one before, which is
            waited for. None where there is none.

        Raises:
            UserError: The learner cannot go on.
        """

    @abstractmethod
    def look(self) -> None:
        """Let between two episodes a newer policy act from now on, if there is one.

        Raises:
            UserError: The learner cannot go on.
        """

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint keeps of the learner after the epoch that came back last."""


class SyncLearner(RunLearner):
    """Learns in this process, while the robot is held.

    Args:
        cell: Robot, simulator and learner.
        progress: Told how far each phase is.
    """

    def __init__(self, cell: TrainingSetup, progress: Progress) -> None:
        super().__init__(cell.learner)
        self._cell = cell
        self._progress = progress

    def begin(self, restored: Restored) -> None:
        """Take over the state of a stopped run, or begin as a new one."""
        if restored.learner is not None:
            self.learner.load_state_dict(restored.learner, restored.by_epoch)

    def exchange(self, lesson: EpochData | None) -> Learned | None:
        """Learn an epoch."""
        if lesson is None:
            return None
        metrics = learn_epoch(
            self.learner,
            lesson.episodes,
            self._cell.config,
            self._cell.run_simulated if lesson.evaluate else None,
            self._progress,
        )
        return Learned(lesson, metrics)

    def look(self) -> None:
        """Nothing changes between two episodes."""

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint keeps of the learner."""
        return self.learner.state_dict()

    def close(self) -> None:
        """Nothing is held."""


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
        run_seeds: Runs the episodes to evaluate it by afterwards; None for none.
        progress: Told how far each phase is.

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
