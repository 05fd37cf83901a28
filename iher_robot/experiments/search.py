"""A search for settings with Optuna: each trial runs the cells of the grid with its own."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from statistics import fmean
from typing import Any

from iher_robot.evaluation.plot import success_points
from iher_robot.experiments.grid import Cell, Identity, expand_grid
from iher_robot.experiments.manifest import Manifest
from iher_robot.experiments.runner import Running
from iher_robot.experiments.search_space import Search
from iher_robot.experiments.study import distributions_of, is_whole, open_study
from iher_robot.storage.files.atomic import write_atomically


class SearchRun:
    """Asks Optuna for settings, runs them, and tells it what they came to.

    The study is a SQLite file in the experiment's folder: trials that were interrupted go on.
    What is drawn for a trial follows from the search's seed, the trial's number and the results
    until then, so that a search that was interrupted goes on as if it had not been.

    Args:
        manifest: The experiment.
        search: Its search.
        running: Runs the cells.

    Raises:
        UserError: Optuna is missing, or the study in the folder is of another search.
    """

    def __init__(self, manifest: Manifest, search: Search, running: Running) -> None:
        self._manifest, self._search, self._running = manifest, search, running
        self._study = open_study(running.folder, search, self._cells(0, {}))
        self._distributions = distributions_of(search)
        self._under_way: dict[int, tuple[Cell, ...]] = {}
        self._failed: set[int] = set()

    @property
    def identities(self) -> list[Identity]:
        """Cells of all trials until now."""
        return [
            cell.identity
            for trial in self._study.get_trials(deepcopy=False)
            if is_whole(trial, self._distributions)
            for cell in self._cells(trial.number, trial.params)
        ]

    def run(self) -> None:
        """Run every trial that is left, as many side by side as there are cores for."""
        self._take_up()
        per_trial = max(1, sum(1 for _ in self._cells(0, {})))
        side_by_side = max(1, self._running.executor.slots // per_trial)
        while True:
            while len(self._under_way) < side_by_side and self._begun < self._search.trials:
                self._ask()
            self._write_trials()
            if not self._under_way:
                return
            if self._running.busy:
                self._running.wait()
            for number, cells in list(self._under_way.items()):
                if all(cell.name in self._running.outcomes for cell in cells):
                    self._tell(number, cells)

    @property
    def _begun(self) -> int:
        return sum(
            is_whole(trial, self._distributions) for trial in self._study.get_trials(deepcopy=False)
        )

    def _take_up(self) -> None:
        """Go on with trials that were interrupted."""
        from optuna.trial import TrialState

        for trial in self._study.get_trials(deepcopy=False):
            if trial.state == TrialState.COMPLETE:
                self._running.prepare(self._cells(trial.number, trial.params))
            elif trial.state == TrialState.RUNNING and is_whole(trial, self._distributions):
                self._begin(trial.number, trial.params)
            elif trial.state == TrialState.RUNNING:  # it was not drawn in full
                self._study.tell(trial.number, state=TrialState.FAIL)

    def _ask(self) -> None:
        from optuna.samplers import TPESampler

        number = len(self._study.get_trials(deepcopy=False))
        # Its random state is not in the study.
        self._study.sampler = TPESampler(
            seed=(self._search.seed + number) % 2**32, constant_liar=True
        )
        trial = self._study.ask(self._distributions)
        self._begin(trial.number, trial.params)

    def _begin(self, number: int, settings: Mapping[str, Any]) -> None:
        cells = tuple(self._cells(number, settings))
        self._running.prepare(cells)
        self._running.folder.add_cells(cell.identity for cell in cells)
        self._running.submit(cells)
        self._under_way[number] = cells
        chosen = ", ".join(f"{key}={value}" for key, value in settings.items())
        self._running.board.say(f"trial {number}: {chosen}")

    def _tell(self, number: int, cells: tuple[Cell, ...]) -> None:
        endings = {self._running.outcomes[cell.name].ending for cell in cells}
        if endings == {"finished"}:
            value = fmean(map(self._value, cells))
            self._study.tell(number, value)
            self._running.board.say(f"trial {number}: {self._search.objective} {value:.3f}")
        elif "failed" in endings:
            self._failed.add(number)
        # One that has no value yet goes on the next time: nothing is told to the study.
        del self._under_way[number]

    def _value(self, cell: Cell) -> float:
        points = success_points(self._running.folder.run(cell.name).read_metrics())
        last = points[-1][1] if points else 0.0
        if self._search.objective == "success-at-budget":
            return last
        wanted, budget = self._search.success, cell.config.budget_minutes
        reached = next((minutes for minutes, rate in points if rate >= wanted), None)
        # Not reached counts as one to two budgets, by how near the last evaluation came.
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
        write_atomically(self._running.folder.trials_path, lambda file: file.write(content))

    def _state(self, trial: Any) -> str:
        if trial.number in self._failed:
            return "failed"
        if trial.number in self._under_way:
            return "running"
        return "complete" if trial.value is not None else "interrupted"
