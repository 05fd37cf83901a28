"""One training run: collect, learn, evaluate, keep; until the budget or the goal is reached."""

from __future__ import annotations

import time
from functools import partial
from typing import Any

import numpy as np
import torch
from torch.utils.tensorboard import SummaryWriter

from drivers import Clock, MonotonicClock
from iher_robot.budget import Budget
from iher_robot.checkpoint import save_checkpoint
from iher_robot.collect import Recorder, Stream, episode_seed, run_episode
from iher_robot.config import dump_config
from iher_robot.display import TrainingDisplay
from iher_robot.episode_store import EpisodeStore
from iher_robot.errors import UserError
from iher_robot.evaluation import run_evaluation
from iher_robot.learning.diagnostics import diagnose
from iher_robot.learning.episode import Episode
from iher_robot.ledger import Ledger
from iher_robot.patience import Patience
from iher_robot.plot import plot_success
from iher_robot.policy_file import save_policy
from iher_robot.provenance import write_provenance
from iher_robot.restore import restore
from iher_robot.robot_episodes import RobotEpisodes
from iher_robot.run_directory import RunDirectory
from iher_robot.trained_policy import trained_policy
from iher_robot.workcell import Workcell

CPU = torch.device("cpu")
MOVED_M = 0.01
"""Displacement of the achieved goal from which an episode counts as one that moved it."""

Row = dict[str, float]


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
        cell: Workcell,
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
        patience = Patience(
            cell.env.driver,
            self.config.patience_minutes,
            directory.path,
            display.announce,
            MonotonicClock() if clock is None else clock,
        )
        self.episodes = RobotEpisodes(cell.env, store, ledger, patience)
        self.writer = writer
        self.provenance = provenance
        self.rows: list[Row] = []
        self.collected = 0
        self.pending: list[Episode] = []
        self.seconds_before = 0.0
        self.started = time.monotonic()

    def run(self) -> Row:
        """Train until the budget is spent or the success rate is reached.

        Returns:
            The last row of metrics.

        Raises:
            UserError: The budget is spent and left nothing to learn from.
        """
        with self.episodes:
            warm_start = self._restore()
            while not self._done():
                if not warm_start:
                    self._collect()
                warm_start = False
                if not self.pending:
                    raise UserError(
                        f"the budget of {self.directory.path} is spent, but it holds no episode to "
                        "learn from; start a new run with another --out"
                    )
                self._learn()
        return self.rows[-1]

    def _restore(self) -> bool:
        """Bring back what the run folder holds; episodes of an unfinished epoch stay pending.

        Everything is checked before anything is written.

        Returns:
            Whether the pending episodes are those of earlier runs.
        """
        restored = restore(self.directory, self.config, self.store, self.ledger)
        self.rows = restored.rows
        self.pending = restored.pending
        self.collected = restored.collected
        if restored.learner is not None:
            self.learner.load_state_dict(restored.learner, restored.by_epoch)
            self.seconds_before = self.rows[-1]["wall_seconds"]
            self.display.resume(self.rows[-1])
        if self.collected:
            self.display.announce(
                f"going on after epoch {len(self.rows)}, with {self.collected} real episodes and "
                f"{self._minutes:.2f} robot minutes spent"
            )
        if restored.warm_start:
            self.display.announce(
                f"learning from {len(self.pending)} real episodes of earlier runs first"
            )
        self.directory.replace_metrics(self.rows)
        write_provenance(self.directory.provenance_path, self.provenance)
        return restored.warm_start

    def _done(self) -> bool:
        rates = [row["success"] for row in self.rows if "success" in row][-2:]
        wanted = self.config.until_success
        if wanted is not None and len(rates) == 2 and min(rates) >= wanted:
            return True
        return self._spent and not self.pending and bool(self.rows)

    @property
    def _spent(self) -> bool:
        return self.budget.remaining_ticks == 0

    @property
    def _minutes(self) -> float:
        return self.cell.minutes_of(self.budget.spent_ticks)

    def _collect(self) -> None:
        """Collect the epoch's real episodes, as far as the budget goes."""
        wanted = self.config.learner.schedule.real_episodes
        policy = self.learner.acting_policy(CPU)
        explorer = self.learner.explorer()
        while len(self.pending) < wanted and not self._spent:
            self.display.phase("collect", len(self.pending), wanted)
            ticks = min(self.cell.env.task.episode_ticks, self.budget.remaining_ticks)
            recorder = self.episodes.run(
                "motion",
                partial(self.budget.reserve, ticks),
                policy,
                epoch=self.learner.epoch + 1,
                seed=episode_seed(self.config.seed, Stream.COLLECTION, self.collected),
                ticks=ticks,
                explorer=explorer,
            )
            episode = recorder.episode()
            if episode is not None:  # counted as the store counts, or a resume would miss one
                self.pending.append(episode)
                self.collected += 1
            self.display.minutes(self._minutes)
            self._tell_of_abort(recorder)

    def _tell_of_abort(self, recorder: Recorder) -> None:
        if recorder.aborted and self.cell.simulator is None:  # a robot that somebody looks after
            self.display.announce(f"{recorder.aborted} (after {recorder.ticks} ticks)")

    def _learn(self) -> None:
        """Learn from the epoch's episodes, evaluate, and write everything down."""
        self.learner.add_real(self.pending)
        row: Row = {
            "robot_minutes": self._minutes,
            "episodes": self.collected,
        }
        if self.cell.env.task.layout.object_entry is not None:
            row["object_moved"] = float(np.mean([self._moved(e) for e in self.pending]))
        try:
            row |= self.learner.learn(self._phase)
        except FloatingPointError as error:
            raise UserError(f"learning stopped in epoch {self.learner.epoch}: {error}") from error
        # What earlier data are worth is to be known before the robot moves.
        first = not self.rows and bool(self.config.from_data)
        if first or self._spent or self.learner.epoch % self.config.evaluation.every_epochs == 0:
            row |= self._evaluate()
        self.pending = []
        row["wall_seconds"] = self.seconds_before + time.monotonic() - self.started
        self.rows.append(row)
        self._write(row)

    def _phase(self, name: str, done: int, total: int) -> None:
        self.episodes.still_idle()
        self.display.phase(name, done, total)

    def _moved(self, episode: Episode) -> bool:
        achieved = self.cell.env.task.goal_model.achieved_goal(episode.observations)
        return bool(np.linalg.norm(achieved - achieved[0], axis=-1).max() > MOVED_M)

    def _evaluate(self) -> Row:
        """Success rate without noise, and what the models make of the same episodes."""
        count = self.cell.evaluation_episodes
        # Its number follows from the epoch, so that a resumed run draws the same episodes.
        first = self.learner.epoch * count
        seeds = [episode_seed(self.config.seed, Stream.EVALUATION, first + i) for i in range(count)]
        policy = self.learner.acting_policy(CPU)
        ticks = self.cell.env.task.episode_ticks

        def run_one(seed: int) -> Recorder:
            if self.cell.simulator is not None:
                recorder = Recorder()
                run_episode(self.cell.simulator, policy, recorder, seed=seed, ticks=ticks)
                return recorder
            reserve = partial(self.ledger.reserve, "evaluation", ticks)
            recorder = self.episodes.run(
                "evaluation", reserve, policy, epoch=self.learner.epoch, seed=seed, ticks=ticks
            )
            self._tell_of_abort(recorder)
            return recorder

        evaluation = run_evaluation(
            run_one, seeds, lambda done: self.display.phase("evaluate", done, count)
        )
        return {"success": evaluation.success_rate} | diagnose(self.learner, evaluation.episodes)

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
            learner=self.learner.state_dict(),
            run={
                "config": dump_config(self.config),
                "episodes": self.collected,
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
