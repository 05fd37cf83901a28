"""Collector: runs the real episodes of each epoch, on the robot or in several simulators."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial

import numpy as np

from drivers import Clock
from drivers.closing import Closing
from iher_robot.evaluation.success_rate import Outcome
from iher_robot.learning.goal_model import moved_goal
from iher_robot.learning.learner import Learner
from iher_robot.rollout.episode import Stream, episode_seed
from iher_robot.rollout.reconnect import ReconnectPolicy
from iher_robot.rollout.recorder import Recorder
from iher_robot.rollout.robot import RobotEpisodes
from iher_robot.rollout.simulators.collect import SimulatedEpisodes
from iher_robot.signals import end_if_terminated
from iher_robot.storage.accounts import Account
from iher_robot.storage.budget import Budget
from iher_robot.storage.episode_store import EpisodeStore
from iher_robot.storage.run_directory import RunDirectory
from iher_robot.training.epoch import EpochData
from iher_robot.training.listener import EpisodeReport, RunListener, TickForwarder
from iher_robot.training.setup import CPU, TrainingSetup


class Collector(Closing):
    """Collects the real episodes of a run, within its budget.

    Args:
        setup: Robot, simulators and learner.
        directory: The run folder.
        budget: Ticks that may be spent.
        store: Store of the real episodes.
        listener: Follows the run.
        clock: Clock for waiting for a lost robot.

    Attributes:
        collected: Real episodes that this run collected.
        pending: Epochs that were collected, in part or whole, and not learned from yet.
    """

    def __init__(
        self,
        setup: TrainingSetup,
        directory: RunDirectory,
        budget: Budget,
        store: EpisodeStore,
        listener: RunListener,
        clock: Clock,
    ) -> None:
        self._setup = setup
        self._budget = budget
        self._listener = listener
        reconnect = ReconnectPolicy(
            setup.env.driver, setup.config.patience_minutes, directory.path, listener.fault, clock
        )
        self._robot = RobotEpisodes(
            setup.env, store, budget.ledger, reconnect, [TickForwarder(listener)]
        )
        self._simulated = self._make_simulated(store)
        self._stack = ExitStack()
        self.collected = 0
        self.pending: list[EpochData] = []

    def _make_simulated(self, store: EpisodeStore) -> SimulatedEpisodes | None:
        pool = self._setup.pool
        if pool is None or self._wanted == 1:
            return None  # one episode cannot be shared
        return SimulatedEpisodes(pool, self._budget, store, self._seed)

    def __enter__(self) -> Collector:
        self._stack.enter_context(self._robot)
        if self._simulated is not None:
            self._stack.enter_context(self._simulated)
        return self

    def close(self) -> None:
        """Settle what is running; closing twice does nothing."""
        self._stack.close()

    @property
    def spent(self) -> bool:
        """Whether the budget is spent."""
        return self._budget.remaining.ticks == 0

    def collect(self, number: int, learner: Learner, between: Callable[[], None]) -> None:
        """Collect an epoch's real episodes as far as the budget goes; it is the last one pending.

        Args:
            number: Number of the epoch, unless a part of one is pending.
            learner: Acts, as it is at the start of each episode.
            between: Called before each episode.
        """
        epoch = self.pending.pop() if self.pending else EpochData(number)
        while len(epoch.episodes) < self._wanted and not self.spent:
            end_if_terminated()
            self._listener.phase("collect", len(epoch.episodes), self._wanted)
            between()
            for outcome in self._run_next(learner, epoch):
                episode = outcome.episode()
                if episode is not None:  # counted as the store counts, or a resume would miss one
                    epoch.episodes.append(episode)
                    self.collected += 1
                self._listener.phase("collect", len(epoch.episodes), self._wanted)
                self._listener.minutes(self._budget.spent.minutes)
                self._report("motion", epoch.number, outcome)
        if epoch.episodes:
            self.pending.append(epoch)

    def take(self) -> EpochData:
        """Take the oldest pending epoch, with the metrics that are known of it."""
        epoch = self.pending.pop(0)
        later_ticks = sum(later.ticks for later in self.pending)
        spent = self._budget.spent  # with epochs that follow this one
        epoch.metrics = {
            "robot_minutes": spent.with_ticks(spent.ticks - later_ticks).minutes,
            "episodes": self.collected - sum(len(later.episodes) for later in self.pending),
        }
        if self._setup.env.task.layout.object_entry is not None:
            model = self._setup.env.task.goal_model
            moved = [moved_goal(model, episode) for episode in epoch.episodes]
            epoch.metrics["object_moved"] = float(np.mean(moved))
        epoch.metrics |= self._robot.jitter.take()
        return epoch

    def evaluation_episode(self, learner: Learner, seed: int) -> Recorder:
        """Run an evaluation episode on the robot, charged to its own account.

        Args:
            learner: Acts as it is now, without noise.
            seed: Decides start and goal.
        """
        ticks = self._setup.env.task.episode_ticks
        recorder = self._robot.run(
            "evaluation",
            partial(self._budget.ledger.reserve, "evaluation", ticks, counted=True),
            learner.acting_policy(CPU),
            epoch=learner.epoch,
            seed=seed,
            ticks=ticks,
        )
        self._report("evaluation", learner.epoch, recorder)
        return recorder

    def still_idle(self) -> None:
        """Charge the robot's idle time so far."""
        self._robot.still_idle()

    def _run_next(self, learner: Learner, epoch: EpochData) -> Iterator[Outcome]:
        """Run the next episode, or several where there are several simulators."""
        if self._simulated is not None:
            count = self._wanted - len(epoch.episodes)
            yield from self._simulated.run(
                learner, epoch=epoch.number, first=self.collected, count=count
            )
            return
        ticks = min(self._setup.env.task.episode_ticks, self._budget.remaining.ticks)
        yield self._robot.run(
            "motion",
            partial(self._budget.reserve, ticks, counted=True),
            learner.acting_policy(CPU),
            epoch=epoch.number,
            seed=self._seed(self.collected),
            ticks=ticks,
            explorer=learner.explorer(),
        )

    def _report(self, account: Account, epoch: int, outcome: Outcome) -> None:
        self._listener.episode(
            EpisodeReport(account, epoch, outcome.ticks, outcome.success, outcome.aborted)
        )
        if outcome.aborted and self._setup.simulator is None:  # a robot that a person looks after
            self._listener.announce(f"{outcome.aborted} (after {outcome.ticks} ticks)")

    @property
    def _wanted(self) -> int:
        return self._setup.config.learner.schedule.real_episodes

    def _seed(self, number: int) -> int:
        return episode_seed(self._setup.config.seed, Stream.COLLECTION, number)
