"""One training run: collect, learn, evaluate, keep; until the budget or the goal is reached."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers import Clock, MonotonicClock
from iher_robot.config.run import dump_identity
from iher_robot.errors import UserError
from iher_robot.evaluation.plot import plot_success
from iher_robot.evaluation.policy_file import save_policy, trained_policy
from iher_robot.evaluation.success_rate import Outcome, evaluate_learner
from iher_robot.learning.episode import Episode
from iher_robot.learning.learner import Learner
from iher_robot.rollout.episode import Recorder, Stream, episode_seed
from iher_robot.rollout.reconnect import ReconnectPolicy
from iher_robot.rollout.robot import RobotEpisodes
from iher_robot.rollout.simulators.collect import SimulatedEpisodes
from iher_robot.signals import end_if_terminated
from iher_robot.storage.budget import Budget
from iher_robot.storage.checkpoint import save_checkpoint
from iher_robot.storage.episode_store import EpisodeStore
from iher_robot.storage.ledger import Ledger
from iher_robot.storage.provenance import write_provenance
from iher_robot.storage.run_directory import RunDirectory
from iher_robot.training.display import TrainingDisplay
from iher_robot.training.epoch import CollectedEpoch, EpochData, Learned, Row
from iher_robot.training.learners.asynchronous import AsyncLearner, LearnerProcess
from iher_robot.training.learners.base import RunLearner, SyncLearner
from iher_robot.training.learners.distributed import DistributedLearner
from iher_robot.training.recovery import restore
from iher_robot.training.setup import CPU, TrainingSetup

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

MOVED_M = 0.01
"""Displacement of the achieved goal from which an episode counts as one that moved it."""


class TrainingRun:
    """The training loop with everything that it writes to.

    Args:
        cell: Robot and learner.
        directory: The run folder; if it holds a checkpoint, the run goes on from there.
        ledger: Accounts of the run.
        store: Its real episodes.
        display: Shows progress.
        writer: TensorBoard scalars.
        provenance: Where the run comes from.
        clock: What waiting for a lost robot is measured by; the machine's own by default.
    """

    def __init__(
        self,
        cell: TrainingSetup,
        directory: RunDirectory,
        ledger: Ledger,
        store: EpisodeStore,
        display: TrainingDisplay,
        writer: SummaryWriter,
        provenance: dict[str, Any],
        clock: Clock | None = None,
    ) -> None:
        self.config = cell.config
        self.cell = cell
        self.learner = cell.learner
        self.directory = directory
        self.ledger = ledger
        self.budget = Budget(ledger, cell.budget_ticks)
        self.store = store
        self.display = display
        patience = ReconnectPolicy(
            cell.env.driver,
            self.config.patience_minutes,
            directory.path,
            display.announce,
            MonotonicClock() if clock is None else clock,
        )
        self.episodes = RobotEpisodes(cell.env, store, ledger, patience)
        self.simulated = self._make_simulated()
        self.learning = self._make_learning()
        self.writer = writer
        self.provenance = provenance
        self.rows: list[Row] = []
        self.collected = 0
        self.pending: list[CollectedEpoch] = []
        self.seconds_before = 0.0
        self._granted_at = 0
        self.started = time.monotonic()

    def _make_simulated(self) -> SimulatedEpisodes | None:
        pool = self.cell.pool
        if pool is None or self.config.learner.schedule.real_episodes == 1:
            return None  # one episode is no work to be shared
        return SimulatedEpisodes(pool, self.budget, self.store, self._seed)

    def _make_learning(self) -> RunLearner:
        if self.config.asynchronous:
            return AsyncLearner(self.cell, LearnerProcess(self.directory.path), self._phase)
        if self.cell.group is not None:
            return DistributedLearner(self.cell, self.cell.group, self.directory.path, self._phase)
        return SyncLearner(self.cell, self._phase)

    def run(self) -> Row:
        """Train until the budget is spent or the success rate is reached.

        Returns:
            The last row of metrics.

        Raises:
            UserError: The budget is spent and left nothing to learn from.
        """
        with ExitStack() as stack:
            stack.enter_context(self.learning)
            stack.enter_context(self.episodes)
            if self.simulated is not None:
                stack.enter_context(self.simulated)
            self._restore()
            while not self._done():
                learned = self.learning.exchange(self._next_lesson())
                if learned is not None:
                    self._finish(learned)
        return self.rows[-1]

    def _restore(self) -> None:
        """Bring back what the run folder holds; episodes of unfinished epochs stay pending.

        Everything is checked before anything is written.
        """
        restored = restore(self.directory, self.config, self.store, self.ledger)
        self.rows = restored.rows
        self.pending = restored.pending
        self.collected = restored.collected
        if self.ledger.granted_ticks:
            self._granted_at = len(self.rows)  # what was granted is to be spent, success or not
        self.learning.begin(restored)
        if self.rows:
            self.seconds_before = self.rows[-1]["wall_seconds"]
            self.display.resume(self.rows[-1])
        if self.collected:
            self.display.announce(
                f"going on after epoch {len(self.rows)}, with {self.collected} real episodes and "
                f"{self.cell.minutes_of(self.budget.spent_ticks):.2f} robot minutes spent"
            )
        if self.pending and self.pending[0].earlier:
            count = len(self.pending[0].episodes)
            self.display.announce(f"learning from {count} real episodes of earlier runs first")
        self.directory.replace_metrics(self.rows)
        write_provenance(self.directory.provenance_path, self.provenance)

    def _done(self) -> bool:
        rates = [row["success"] for row in self.rows[self._granted_at :] if "success" in row][-2:]
        wanted = self.config.until_success
        if wanted is not None and len(rates) == 2 and min(rates) >= wanted:
            return True
        waits = self.pending or self.learning.under_way
        return self._spent and not waits and bool(self.rows)

    @property
    def _spent(self) -> bool:
        return self.budget.remaining_ticks == 0

    def _next_lesson(self) -> EpochData | None:
        """The next epoch to learn from, collected as far as the budget goes; None without one."""
        under_way = self.learning.under_way
        if under_way is not None and under_way.earlier:
            return None  # what earlier data are worth is to be known before the robot moves
        # One that another follows was whole.
        if not self.pending or not (self.pending[0].earlier or self.pending[1:]):
            self._collect()
        if self.pending:
            return self._lesson(self.pending.pop(0))
        if not self.rows and under_way is None:
            raise UserError(
                f"the budget of {self.directory.path} is spent, but it holds no episode to "
                "learn from; start a new run with another --out"
            )
        return None

    def _collect(self) -> None:
        """Collect the epoch's real episodes, as far as the budget goes."""
        number = len(self.rows) + (self.learning.under_way is not None) + 1
        epoch = self.pending.pop() if self.pending else CollectedEpoch(number)
        wanted = self.config.learner.schedule.real_episodes
        while len(epoch.episodes) < wanted and not self._spent:
            end_if_terminated()
            self.display.phase("collect", len(epoch.episodes), wanted)
            self.learning.look()
            for outcome in self._run_next(epoch.number, wanted - len(epoch.episodes)):
                episode = outcome.episode()
                if episode is not None:  # counted as the store counts, or a resume would miss one
                    epoch.episodes.append(episode)
                    self.collected += 1
                self.display.phase("collect", len(epoch.episodes), wanted)
                self.display.minutes(self.cell.minutes_of(self.budget.spent_ticks))
                self._tell_of_abort(outcome)
        if epoch.episodes:
            self.pending.append(epoch)

    def _run_next(self, epoch: int, count: int) -> Iterator[Outcome]:
        """Run the next episode, or so many of them where there are several simulators."""
        if self.simulated is not None:
            yield from self.simulated.run(
                self.learner, epoch=epoch, first=self.collected, count=count
            )
            return
        ticks = min(self.cell.env.task.episode_ticks, self.budget.remaining_ticks)
        yield self.episodes.run(
            "motion",
            partial(self.budget.reserve, ticks, counted=True),
            self.learner.acting_policy(CPU),
            epoch=epoch,
            seed=self._seed(self.collected),
            ticks=ticks,
            explorer=self.learner.explorer(),
        )

    def _seed(self, number: int) -> int:
        return episode_seed(self.config.seed, Stream.COLLECTION, number)

    def _tell_of_abort(self, outcome: Outcome) -> None:
        if outcome.aborted and self.cell.simulator is None:  # a robot that somebody looks after
            self.display.announce(f"{outcome.aborted} (after {outcome.ticks} ticks)")

    def _lesson(self, epoch: CollectedEpoch) -> EpochData:
        """Put an epoch together with what is known of it; those that follow it do not count."""
        ticks = self.budget.spent_ticks - sum(later.ticks for later in self.pending)
        known: Row = {
            "robot_minutes": self.cell.minutes_of(ticks),
            "episodes": self.collected - sum(len(later.episodes) for later in self.pending),
        }
        if self.cell.env.task.layout.object_entry is not None:
            known["object_moved"] = float(np.mean([self._moved(e) for e in epoch.episodes]))
        # What earlier data are worth is to be known before the robot moves.
        first = epoch.number == 1 and bool(self.config.from_data)
        last = self._spent and not self.pending
        return EpochData(
            epoch=epoch.number,
            episodes=epoch.episodes,
            evaluate=first or last or epoch.number % self.config.evaluation.every_epochs == 0,
            known=known | self.episodes.jitter.take(),
            earlier=epoch.earlier,
        )

    def _moved(self, episode: Episode) -> bool:
        achieved = self.cell.env.task.goal_model.achieved_goal(episode.observations)
        return bool(np.linalg.norm(achieved - achieved[0], axis=-1).max() > MOVED_M)

    def _finish(self, learned: Learned) -> None:
        """Evaluate an epoch where only the robot can tell, and write everything down."""
        lesson = learned.lesson
        row = dict(lesson.known) | dict(learned.metrics)
        if lesson.evaluate and self.cell.simulator is None:
            row |= evaluate_learner(
                self.learner,
                self._run_evaluated,
                run_seed=self.config.seed,
                count=self.cell.evaluation_episodes,
                progress=self._phase,
            )
        row["wall_seconds"] = self.seconds_before + time.monotonic() - self.started
        self.rows.append(row)
        self._write(row)

    def _run_evaluated(self, learner: Learner, seeds: Sequence[int]) -> Iterator[Recorder]:
        ticks, policy = self.cell.env.task.episode_ticks, learner.acting_policy(CPU)
        for seed in seeds:
            recorder = self.episodes.run(
                "evaluation",
                partial(self.ledger.reserve, "evaluation", ticks, counted=True),
                policy,
                epoch=learner.epoch,
                seed=seed,
                ticks=ticks,
            )
            self._tell_of_abort(recorder)
            yield recorder

    def _phase(self, name: str, done: int, total: int) -> None:
        end_if_terminated()
        self.episodes.still_idle()
        self.display.phase(name, done, total)

    def _write(self, row: Row) -> None:
        # Metrics first: on resume, they are replaced by those of the checkpoint.
        self.directory.append_metrics(row)
        for name, value in row.items():
            self.writer.add_scalar(name, value, int(row["epoch"]))
        self.writer.flush()
        save_policy(
            self.directory.policy_path,
            trained_policy(
                self.learner.acting_policy(CPU), self.cell.env, self.config, self.provenance, row
            ),
        )
        save_checkpoint(
            self.directory.checkpoint_path,
            learner=self.learning.state_dict(),
            run={
                "config": dump_identity(self.config),
                "episodes": row["episodes"],
                "ledger_entry": self.ledger.last_entry,
                "rows": self.rows,
            },
        )
        self._plot()
        self.display.epoch(row)

    def _plot(self) -> None:
        config = self.config
        label = f"{config.algo}, preset {config.preset}"
        plot_success(
            {label: self.rows},
            self.directory.plot_path,
            title=f"{config.task} on {config.chosen_robot.title}",
            subtitle=f"seed {config.seed}, commit {self.provenance['commit'][:10]}",
            budget_minutes=self.cell.minutes_of(self.budget.budget_ticks),
        )
