"""Runs cells with an executor and keeps the board up to date."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path

from iher_robot.config.run import RunConfig, dump_config, read_config
from iher_robot.errors import UserError, describe
from iher_robot.experiments.cell_process import Order, Outcome
from iher_robot.experiments.executor import Executor
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.experiments.grid import Cell, differences
from iher_robot.experiments.progress import Board, Line
from iher_robot.storage.files.atomic import write_atomically
from iher_robot.storage.run_directory import Row
from iher_robot.storage.run_result import read_result

# What a run that was ended before its settings were written leaves.
_LEFTOVERS = {"config.yaml", ".config.yaml.tmp"}


def prepare(folder: ExperimentFolder, cell: Cell) -> str:
    """Look into the folder of a cell before it is run.

    Returns:
        ``"finished"``, ``"interrupted"`` or ``"new"``.

    Raises:
        UserError: A run with other settings is there, or its settings are damaged.
    """
    run = folder.run(cell.name)
    if not run.path.exists():
        return "new"
    if not run.config_path.exists() or not run.config_path.read_bytes():
        if {entry.name for entry in run.path.iterdir()} <= _LEFTOVERS:
            shutil.rmtree(run.path)
            return "new"
        raise UserError(f"{run.path} is no run of this experiment: move it away")
    run.check_config()
    there = read_config(run.config_path)
    if differences(there, cell.config):
        raise UserError(
            f"{run.path} was run with {_told(there, cell.config)}; "
            "give the experiment another --out, or move that folder away"
        )
    return "interrupted" if read_result(run.result_path) is None else "finished"


def _told(there: RunConfig, wanted: RunConfig) -> str:
    found = differences(there, wanted)
    told = [
        f"{key} {was!r}, where the manifest has {now!r}"
        for key, (was, now) in list(found.items())[:3]
    ]
    more = f" and {len(found) - 3} more" if len(found) > 3 else ""
    return "; ".join(told) + more


_LOOK_S = 1.0
_LAST = "result.json"  # with it a cell counts as finished


class Running:
    """Cells that are being run.

    Args:
        folder: Folder of the experiment.
        executor: Who runs them.
        board: Where to show them.

    Attributes:
        outcomes: How cells ended, by name.
    """

    def __init__(self, folder: ExperimentFolder, executor: Executor, board: Board) -> None:
        self.folder = folder
        self.executor = executor
        self.board = board
        self.outcomes: dict[str, Outcome] = {}
        self._futures: dict[Future[Outcome], str] = {}
        self._read: dict[str, int] = {}

    @property
    def busy(self) -> bool:
        """Whether a cell has not ended."""
        return bool(self._futures)

    def prepare(self, cells: Iterable[Cell]) -> None:
        """Look at the folders of cells; those that have finished are not run again.

        Raises:
            UserError: A folder holds a run with other settings, or a damaged one.
        """
        for cell in cells:
            found = prepare(self.folder, cell)
            line = Line(cell.name, cell.config.budget_minutes)
            if found == "finished":
                line.state = "finished"
                self.outcomes[cell.name] = Outcome(cell.name, "finished")
            elif found == "interrupted":
                line.note = "goes on from its last epoch"
            self.board.add(line)
            self._look(line)

    def submit(self, cells: Iterable[Cell]) -> None:
        """Hand prepared cells to the executor."""
        for cell in cells:
            if cell.name not in self.outcomes:
                run, log = self.folder.run(cell.name).path, self.folder.log(cell.name)
                self.folder.failure(cell.name).unlink(missing_ok=True)
                order = Order(cell.name, dump_config(cell.config), run, log)
                self._futures[self.executor.submit(order)] = cell.name

    def wait(self) -> None:
        """Wait a moment, or until a cell ends, and show what changed."""
        done, _ = wait(self._futures, timeout=_LOOK_S, return_when=FIRST_COMPLETED)
        running = self.executor.running
        for name in self._futures.values():
            line = self.board.lines[name]
            if name in running and line.state == "waiting":
                self.board.change(name, "running", line.note)
            if line.state == "running":
                self._look(line)
        for future in done:
            name = self._futures.pop(future)
            outcome = self._outcome(name, future)
            self._keep(outcome)
            self.outcomes[name] = outcome
            self._look(self.board.lines[name])
            self._tell(outcome)

    def _outcome(self, name: str, future: Future[Outcome]) -> Outcome:
        error = future.exception()
        if error is None:
            return future.result()
        reason = str(error) if isinstance(error, UserError) else describe(error)
        return Outcome(name, "failed", reason)

    def _keep(self, outcome: Outcome) -> None:
        """Write down why it failed, and the small files of a run that was made elsewhere."""
        folder = self.folder.run(outcome.name).path
        for name in sorted(outcome.files, key=lambda name: name == _LAST):
            path = self.folder.log(outcome.name) if name == "log" else folder / name
            _write(path, outcome.files[name])
        if outcome.ending == "failed":
            reason = ": ".join([outcome.reason, *outcome.lines[-1:]])
            _write(self.folder.failure(outcome.name), f"{reason}\n".encode())

    def _tell(self, outcome: Outcome) -> None:
        place = f"on {outcome.place}" if outcome.place else ""
        if outcome.ending == "finished":
            self.board.change(outcome.name, "finished", place)
            return
        note = ", ".join(filter(None, (outcome.reason, place)))
        self.board.change(outcome.name, outcome.ending, note)
        if outcome.ending == "failed":
            self.board.say(f"{outcome.name} failed ({note}); {self.folder.log(outcome.name)} ends:")
            for line in outcome.lines:
                self.board.say(f"    {line}")

    def _look(self, line: Line) -> None:
        """Read the metrics of a cell, if there are new ones."""
        run = self.folder.run(line.name)
        try:
            size = run.metrics_path.stat().st_size
            if size == self._read.get(line.name):
                return
            rows = run.read_metrics()
        except (OSError, UserError):  # not there, or just being replaced
            return
        self._read[line.name] = size
        if rows:
            success = next((row["success"] for row in reversed(rows) if "success" in row), None)
            line.row = _with(rows[-1], success)


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lambda file: file.write(content))


def _with(row: Row, success: float | None) -> Row:
    return dict(row) | ({} if success is None else {"success": success})
