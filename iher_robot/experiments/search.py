"""Search for settings with Optuna: each trial runs the cells of the grid with its settings."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from statistics import fmean
from typing import Any

from iher_robot.evaluation.plot import success_points
from iher_robot.experiments.grid import Cell, Identity, expand_grid
from iher_robot.experiments.manifest import Manifest
from iher_robot.experiments.runner import CellRunner
from iher_robot.experiments.search_space import Search
from iher_robot.experiments.study import distributions_of, is_whole, open_study
from iher_robot.storage.files.atomic import write_atomically


class SearchRun:
    """Search loop: ask Optuna for settings, run their cells, report the value.

    The study is a SQLite file in the experiment's folder: interrupted trials continue. The
    settings of a trial depend on the search's seed, the trial's number and the results so far, so
    that an interrupted search continues as an uninterrupted one.

    Args:
        manifest: The experiment.
        search: Its search.
        runner: Runs the cells.

    Raises:
        UserError: Optuna is missing, or the study in the folder belongs to another search.
    """

    def __init__(self, manifest: Manifest, search: Search, runner: CellRunner) -> None:
        self._manifest, self._search, self._runner = manifest, search, runner
        self._study = open_study(runner.folder, search, self._cells(0, {}))
        self._distributions = distributions_of(search)
        self._active: dict[int, tuple[Cell, ...]] = {}
        self._failed: set[int] = set()

    @property
    def identities(self) -> list[Identity]:
        """Cells of all trials so far."""
        return [
            cell.identity
            for trial in self._study.get_trials(deepcopy=False)
            if is_whole(trial, self._distributions)
            for cell in self._cells(trial.number, trial.params)
        ]

    def run(self) -> None:
        """Run every trial that is left, in parallel as far as there are cores."""
        self._resume_trials()
        per_trial = max(1, sum(1 for _ in self._cells(0, {})))
        parallel = max(1, self._runner.executor.slots // per_trial)
        while True:
            while len(self._active) < parallel and self._started < self._search.trials:
                self._ask()
            self._write_trials()
            if not self._active:
                return
            if self._runner.busy:
                self._runner.wait()
            for number, cells in list(self._active.items()):
                if all(cell.name in self._runner.outcomes for cell in cells):
                    self._finish(number, cells)

    @property
    def _started(self) -> int:
        return sum(
            is_whole(trial, self._distributions) for trial in self._study.get_trials(deepcopy=False)
        )

    def _resume_trials(self) -> None:
        """Continue interrupted trials."""
        from optuna.trial import TrialState

        for trial in self._study.get_trials(deepcopy=False):
            if trial.state == TrialState.COMPLETE:
                self._runner.prepare(self._cells(trial.number, trial.params))
            elif trial.state == TrialState.RUNNING and is_whole(trial, self._distributions):
                self._start(trial.number, trial.params)
            elif trial.state == TrialState.RUNNING:  # an interrupt came while it was drawn
                self._study.tell(trial.number, state=TrialState.FAIL)

    def _ask(self) -> None:
        from optuna.samplers import TPESampler

        number = len(self._study.get_trials(deepcopy=False))
        # The study does not store the sampler's random state.
        self._study.sampler = TPESampler(
            seed=(self._search.seed + number) % 2**32, constant_liar=True
        )
        trial = self._study.ask(self._distributions)
        self._start(trial.number, trial.params)

    def _start(self, number: int, settings: Mapping[str, Any]) -> None:
        cells = tuple(self._cells(number, settings))
        self._runner.prepare(cells)
        self._runner.folder.add_cells(cell.identity for cell in cells)
        self._runner.submit(cells)
        self._active[number] = cells
        chosen = ", ".join(f"{key}={value}" for key, value in settings.items())
        self._runner.progress.print(f"trial {number}: {chosen}")

    def _finish(self, number: int, cells: tuple[Cell, ...]) -> None:
        endings = {self._runner.outcomes[cell.name].ending for cell in cells}
        if endings == {"finished"}:
            value = fmean(map(self._value, cells))
            self._study.tell(number, value)
            self._runner.progress.print(f"trial {number}: {self._search.objective} {value:.3f}")
        elif "failed" in endings:
            self._failed.add(number)
        # A trial without a value stays running in the study and continues the next time.
        del self._active[number]

    def _value(self, cell: Cell) -> float:
        points = success_points(self._runner.folder.run(cell.name).read_metrics())
        last = points[-1][1] if points else 0.0
        if self._search.objective == "success-at-budget":
            return last
        wanted, budget = self._search.success, cell.config.budget_minutes
        reached = next((minutes for minutes, rate in points if rate >= wanted), None)
        # Not reached counts as one to two budgets, by the last success rate.
        return budget * (2.0 - min(1.0, last / wanted)) if reached is None else reached

    def _cells(self, number: int, settings: Mapping[str, Any]) -> Iterator[Cell]:
        (grid,) = self._manifest.grids
        origin = f"{self._manifest.origin}, trial {number}"
        return expand_grid(grid, origin, settings, f"trial{number:03d}")

    def _write_trials(self) -> None:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["trial", "state", self._search.objective, *self._distributions])
        for trial in self._study.get_trials(deepcopy=False):
            if is_whole(trial, self._distributions):
                value = "" if trial.value is None else repr(trial.value)
                settings = [trial.params[key] for key in self._distributions]
                writer.writerow([trial.number, self._state(trial), value, *settings])
        content = text.getvalue().encode()
        write_atomically(self._runner.folder.trials_path, lambda file: file.write(content))

    def _state(self, trial: Any) -> str:
        if trial.number in self._failed:
            return "failed"
        if trial.number in self._active:
            return "running"
        return "complete" if trial.value is not None else "interrupted"
