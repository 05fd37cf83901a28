"""Cell runner: hands cells to an executor, keeps their outcomes, updates the progress table."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from typing import Any, Literal

from iher_robot.config.run import RunConfig, dump_config, read_config
from iher_robot.errors import UserError, describe
from iher_robot.experiments.cell_process import CellJob, Outcome
from iher_robot.experiments.executor import Executor
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.experiments.grid import Cell, differences
from iher_robot.experiments.progress import CellProgress, ProgressTable
from iher_robot.storage.files.atomic import write_atomically
from iher_robot.storage.run_directory import Row
from iher_robot.storage.run_result import read_result

_POLL_S = 1.0
_LAST_FILE = "result.json"  # with it a cell counts as finished
# What a run leaves that ends before its settings are written.
_LEFTOVERS = {"config.yaml", ".config.yaml.tmp"}


class CellRunner:
    """Runs cells.

    Args:
        folder: Folder of the experiment.
        executor: Runs the processes of cells.
        progress: Table that shows them.

    Attributes:
        outcomes: How cells ended, by name.
    """

    def __init__(
        self, folder: ExperimentFolder, executor: Executor, progress: ProgressTable
    ) -> None:
        self.folder = folder
        self.executor = executor
        self.progress = progress
        self.outcomes: dict[str, Outcome] = {}
        self._futures: dict[Future[Outcome], str] = {}
        self._metrics_sizes: dict[str, int] = {}

    @property
    def busy(self) -> bool:
        """Whether a cell has not ended."""
        return bool(self._futures)

    def prepare(self, cells: Iterable[Cell]) -> None:
        """Check the folders of cells; those that have finished are not run again.

        Raises:
            UserError: A folder holds a run with other settings, or a damaged one.
        """
        for cell in cells:
            found = prepare_cell(self.folder, cell)
            shown = CellProgress(cell.name, cell.config.budget_minutes)
            if found == "finished":
                shown.state = "finished"
                self.outcomes[cell.name] = Outcome(cell.name, "finished")
            elif found == "interrupted":
                shown.note = "continues from its last epoch"
            self.progress.add(shown)
            self._read_metrics(shown)

    def submit(self, cells: Iterable[Cell]) -> None:
        """Hand prepared cells to the executor."""
        for cell in cells:
            name = cell.name
            if name not in self.outcomes:
                self.folder.failure(name).unlink(missing_ok=True)
                job = CellJob(
                    name=name,
                    config=dump_config(cell.config),
                    config_path=self.folder.config(name),
                    run=self.folder.run(name).path,
                    log=self.folder.log(name),
                )
                self._futures[self.executor.submit(job)] = name

    def wait(self) -> None:
        """Wait a second, or until a cell ends, and show what changed."""
        done, _ = wait(self._futures, timeout=_POLL_S, return_when=FIRST_COMPLETED)
        running = self.executor.running
        for name in self._futures.values():
            shown = self.progress.cells[name]
            if name in running and shown.state == "waiting":
                self.progress.change(name, "running", shown.note)
            if shown.state == "running":
                self._read_metrics(shown)
        for future in done:
            name = self._futures.pop(future)
            outcome = _outcome(name, future)
            self._store(outcome)
            self.outcomes[name] = outcome
            self._read_metrics(self.progress.cells[name])
            self._show(outcome)

    def _store(self, outcome: Outcome) -> None:
        """Write why a cell failed, and the small files of a run on another machine."""
        folder = self.folder.run(outcome.name).path
        for name in sorted(outcome.files, key=lambda name: name == _LAST_FILE):
            path = self.folder.log(outcome.name) if name == "log" else folder / name
            _write(path, outcome.files[name])
        if outcome.ending == "failed":
            reason = ": ".join([outcome.reason, *outcome.lines[-1:]])
            _write(self.folder.failure(outcome.name), f"{reason}\n".encode())

    def _show(self, outcome: Outcome) -> None:
        node = f"on {outcome.node}" if outcome.node else ""
        if outcome.ending == "finished":
            self.progress.change(outcome.name, "finished", node)
            return
        note = ", ".join(filter(None, (outcome.reason, node)))
        self.progress.change(outcome.name, outcome.ending, note)
        if outcome.ending == "failed":
            log = self.folder.log(outcome.name)
            self.progress.print(f"{outcome.name} failed ({note}); {log} ends:")
            for line in outcome.lines:
                self.progress.print(f"    {line}")

    def _read_metrics(self, shown: CellProgress) -> None:
        """Read the metrics of a cell, if there are new ones."""
        run = self.folder.run(shown.name)
        try:
            size = run.metrics_path.stat().st_size
            if size == self._metrics_sizes.get(shown.name):
                return
            rows = run.read_metrics()
        except (OSError, UserError):  # missing, or being replaced
            return
        self._metrics_sizes[shown.name] = size
        if rows:
            shown.row = _last_row(rows)


def prepare_cell(folder: ExperimentFolder, cell: Cell) -> Literal["finished", "interrupted", "new"]:
    """Check the folder of a cell before it is run, and remove the leftovers of a failed start.

    Raises:
        UserError: The folder holds a run with other settings, or its settings are damaged.
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
    config = read_config(run.config_path)
    if differences(config, cell.config):
        raise UserError(
            f"{run.path} was run with {_describe_differences(config, cell.config)}; "
            "give the experiment another --out, or move that folder away"
        )
    return "interrupted" if read_result(run.result_path) is None else "finished"


def _describe_differences(config: RunConfig, wanted: RunConfig) -> str:
    found = differences(config, wanted)
    shown = [
        f"{key} {was!r}, where the manifest has {now!r}"
        for key, (was, now) in list(found.items())[:3]
    ]
    more = f" and {len(found) - 3} more" if len(found) > 3 else ""
    return "; ".join(shown) + more


def _outcome(name: str, future: Future[Outcome]) -> Outcome:
    error = future.exception()
    if error is None:
        return future.result()
    reason = str(error) if isinstance(error, UserError) else describe(error)
    return Outcome(name, "failed", reason)


def _last_row(rows: list[dict[str, Any]]) -> Row:
    """The last metrics, with the last success rate."""
    success = next((row["success"] for row in reversed(rows) if "success" in row), None)
    return dict(rows[-1]) | ({} if success is None else {"success": success})


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lambda file: file.write(content))
