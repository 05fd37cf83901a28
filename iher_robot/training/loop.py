"""Training loop: collect, learn, evaluate and save, until the budget or the goal is reached."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from typing import Any

from drivers import Clock, MonotonicClock
from iher_robot.config.run import dump_identity
from iher_robot.errors import UserError
from iher_robot.evaluation.policy_file import make_policy_file, save_policy
from iher_robot.evaluation.success_rate import evaluate_learner
from iher_robot.learning.learner import Learner
from iher_robot.rollout.recorder import Recorder
from iher_robot.signals import end_if_terminated
from iher_robot.storage.budget import Budget
from iher_robot.storage.checkpoint import save_checkpoint
from iher_robot.storage.episode_store import EpisodeStore
from iher_robot.storage.provenance import write_provenance
from iher_robot.storage.run_directory import RunDirectory
from iher_robot.training.collector import Collector
from iher_robot.training.epoch import EpochData, LearnedEpoch, Row
from iher_robot.training.learners.asynchronous import AsyncLearner, LearnerProcess
from iher_robot.training.learners.base import RunLearner, SyncLearner
from iher_robot.training.learners.distributed import DistributedLearner
from iher_robot.training.listener import RunListener
from iher_robot.training.recovery import restore
from iher_robot.training.setup import CPU, TrainingSetup


class TrainingRun:
    """The training loop and what it writes to.

    Args:
        setup: Robot, simulators and learner.
        directory: The run folder; if it holds a checkpoint, the run goes on from there.
        budget: Budget of the run, with its ledger.
        store: Store of its real episodes.
        listener: Follows the run.
        provenance: Command, commit, versions and machine of the run.
        clock: Clock for waiting for a lost robot; the machine's own by default.

    Attributes:
        rows: Metrics of the finished epochs.
    """

    def __init__(
        self,
        setup: TrainingSetup,
        directory: RunDirectory,
        budget: Budget,
        store: EpisodeStore,
        listener: RunListener,
        provenance: dict[str, Any],
        clock: Clock | None = None,
    ) -> None:
        self.config = setup.config
        self.setup = setup
        self.directory = directory
        self.budget = budget
        self.ledger = budget.ledger
        self.store = store
        self.listener = listener
        self.provenance = provenance
        self.collector = Collector(
            setup, directory, self.budget, store, listener, clock or MonotonicClock()
        )
        self.learning = self._make_learning()
        self.rows: list[Row] = []
        self.seconds_before = 0.0
        self._granted_at = 0
        self.started = time.monotonic()

    def _make_learning(self) -> RunLearner:
        if self.config.asynchronous:
            return AsyncLearner(self.setup, LearnerProcess(self.directory.path), self._phase)
        if self.setup.group is not None:
            return DistributedLearner(
                self.setup, self.setup.group, self.directory.path, self._phase
            )
        return SyncLearner(self.setup, self._phase)

    def run(self) -> Row:
        """Train until the budget is spent or the success rate is reached.

        Returns:
            The last row of metrics.

        Raises:
            UserError: The budget is spent and left nothing to learn from.
        """
        with ExitStack() as stack:
            stack.enter_context(self.learning)
            stack.enter_context(self.collector)
            self._restore()
            while not self._done():
                learned = self.learning.exchange(self._next_epoch())
                if learned is not None:
                    self._finish(learned)
        return self.rows[-1]

    def _restore(self) -> None:
        """Bring back what the run folder holds; episodes of unfinished epochs stay pending.

        Everything is checked before anything is written.
        """
        restored = restore(self.directory, self.config, self.store, self.ledger)
        self.rows = restored.rows
        self.collector.pending = restored.pending
        self.collector.collected = restored.collected
        if self.ledger.granted_ticks:
            self._granted_at = len(self.rows)  # what was granted is to be spent, success or not
        self.learning.begin(restored)
        if self.rows:
            self.seconds_before = self.rows[-1]["wall_seconds"]
            self.listener.resume(self.rows)
        if restored.collected:
            self.listener.announce(
                f"going on after epoch {len(self.rows)}, with {restored.collected} real episodes "
                f"and {self.budget.spent} spent"
            )
        if restored.pending and restored.pending[0].earlier:
            count = len(restored.pending[0].episodes)
            self.listener.announce(f"learning from {count} real episodes of earlier runs first")
        self.directory.replace_metrics(self.rows)
        write_provenance(self.directory.provenance_path, self.provenance)

    def _done(self) -> bool:
        rates = [row["success"] for row in self.rows[self._granted_at :] if "success" in row][-2:]
        wanted = self.config.until_success
        if wanted is not None and len(rates) == 2 and min(rates) >= wanted:
            return True
        waits = self.collector.pending or self.learning.under_way
        return self.collector.spent and not waits and bool(self.rows)

    def _next_epoch(self) -> EpochData | None:
        """The next epoch to learn from, collected as far as the budget goes; None without one."""
        under_way = self.learning.under_way
        if under_way is not None and under_way.earlier:
            return None  # what earlier data are worth is to be known before the robot moves
        pending = self.collector.pending
        # One that another follows was whole.
        if not pending or not (pending[0].earlier or pending[1:]):
            number = len(self.rows) + (under_way is not None) + 1
            self.collector.collect(number, self.learning.learner, self.learning.look)
        if pending:
            return self._hand_over(self.collector.take())
        if not self.rows and under_way is None:
            raise UserError(
                f"the budget of {self.directory.path} is spent, but it holds no episode to "
                "learn from; start a new run with another --out"
            )
        return None

    def _hand_over(self, epoch: EpochData) -> EpochData:
        # What earlier data are worth is to be known before the robot moves.
        first = epoch.number == 1 and bool(self.config.from_data)
        last = self.collector.spent and not self.collector.pending
        epoch.evaluate = first or last or epoch.number % self.config.evaluation.every_epochs == 0
        return epoch

    def _finish(self, learned: LearnedEpoch) -> None:
        """Evaluate an epoch where only the robot can, and save everything."""
        row = learned.data.metrics | dict(learned.metrics)
        if learned.data.evaluate and self.setup.simulator is None:
            row |= evaluate_learner(
                self.learning.learner,
                self._run_evaluated,
                run_seed=self.config.seed,
                count=self.setup.evaluation_episodes,
                progress=self._phase,
            )
        row["wall_seconds"] = self.seconds_before + time.monotonic() - self.started
        self.rows.append(row)
        self._save(row)
        self.listener.epoch(row)

    def _run_evaluated(self, learner: Learner, seeds: Sequence[int]) -> Iterator[Recorder]:
        for seed in seeds:
            yield self.collector.evaluation_episode(learner, seed)

    def _phase(self, name: str, done: int, total: int) -> None:
        end_if_terminated()
        self.collector.still_idle()
        self.listener.phase(name, done, total)

    def _save(self, row: Row) -> None:
        # Metrics first: on resume, they are replaced by those of the checkpoint.
        self.directory.append_metrics(row)
        policy = self.learning.learner.acting_policy(CPU)
        save_policy(
            self.directory.policy_path,
            make_policy_file(policy, self.setup.env, self.config, self.provenance, row),
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
