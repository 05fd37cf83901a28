"""Run every cell of a manifest: the application behind ``iher-robot experiment``."""

from __future__ import annotations

import datetime
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from iher_robot.errors import UserError
from iher_robot.experiments.cell_process import Outcome
from iher_robot.experiments.executor_options import ExecutorOptions
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.experiments.grid import Cell, expand
from iher_robot.experiments.manifest import Manifest, read_manifest
from iher_robot.experiments.progress import ProgressTable
from iher_robot.experiments.report.report import ReportResult, report
from iher_robot.experiments.runner import CellRunner, prepare_cell
from iher_robot.storage.files.lock import LockFile
from iher_robot.storage.provenance import collect_provenance

DEFAULT_FOLDER = Path("runs/experiments")


@dataclass(frozen=True)
class ExperimentResult:
    """How an experiment ended.

    Attributes:
        folder: Its folder.
        outcomes: How each cell ended.
        logs: Log of each cell, by name.
        report: The report, or the reason why there is none.
    """

    folder: Path
    outcomes: tuple[Outcome, ...]
    logs: dict[str, Path]
    report: ReportResult | str

    @property
    def failed(self) -> tuple[Outcome, ...]:
        """Cells that did not finish."""
        return tuple(outcome for outcome in self.outcomes if outcome.ending != "finished")

    @property
    def complete(self) -> bool:
        """Whether every cell has finished and there is a report."""
        return not self.failed and isinstance(self.report, ReportResult)

    def summary(self) -> str:
        """The result in a few lines."""
        total = len(self.outcomes)
        lines = [f"{total - len(self.failed)} of {total} cells finished: {self.folder}"]
        lines += [
            f"{outcome.ending:<12}{outcome.name}: {outcome.reason}, see {self.logs[outcome.name]}"
            for outcome in self.failed
        ]
        report = self.report if isinstance(self.report, str) else self.report.summary()
        return "\n".join([*lines, report])


def experiment(
    manifest: str,
    *,
    out: Path | None = None,
    executor: str = "local",
    workers: int | None = None,
    address: str | None = None,
    ship: bool = False,
    only: Sequence[str] = (),
    display: bool = True,
) -> ExperimentResult:
    """Run every cell of a manifest that has not finished yet, and write the report.

    Args:
        manifest: Name of a shipped experiment, or the path of a YAML file.
        out: Folder of the experiment; by default one of its name in ``runs/experiments``. An
            existing one continues.
        executor: ``local`` runs cells as processes of this machine, ``ray`` on a Ray cluster.
        workers: Number of parallel cells with ``local``; by default one per core.
        address: Address of the Ray cluster; by default that of the environment, or a new one on
            this machine.
        ship: With ``ray``, run cells on the nodes' own disks, even where they see `out`.
        only: Patterns such as ``push-*-seed0``: only cells whose names match one of them are run.
        display: Show progress.

    Returns:
        How it ended; a failed cell does not end the others.

    Raises:
        UserError: Bad input; no cell has been started.
    """
    plan = read_manifest(manifest)
    cells = expand(plan)
    folder = ExperimentFolder(out or DEFAULT_FOLDER / Path(manifest).stem)
    options = ExecutorOptions(executor, workers, address, ship)
    options.check(cells)
    chosen = _choose(plan, cells, only)
    again = f"iher-robot {shlex.join(sys.argv[1:])}"
    with folder.hold() as lock:
        try:
            outcomes = _run(plan, cells, chosen, folder, options, lock, display=display)
        except KeyboardInterrupt as error:
            error.add_note(f"continue with: {again}")
            raise
        result = _report(folder)
    logs = {outcome.name: folder.log(outcome.name) for outcome in outcomes}
    return ExperimentResult(folder.path, outcomes, logs, result)


def _choose(manifest: Manifest, cells: Sequence[Cell], only: Sequence[str]) -> Sequence[Cell]:
    if not only:
        return cells
    if manifest.search is not None:
        raise UserError(
            "--only selects cells of a grid, and this manifest is a search; leave it out"
        )
    for pattern in only:
        if not any(fnmatchcase(cell.name, pattern) for cell in cells):
            raise UserError(
                f"--only is {pattern!r}, which matches none of the {len(cells)} cells, such as "
                f"{cells[0].name}"
            )
    return [cell for cell in cells if any(fnmatchcase(cell.name, pattern) for pattern in only)]


def _run(
    manifest: Manifest,
    cells: Sequence[Cell],
    chosen: Sequence[Cell],
    folder: ExperimentFolder,
    options: ExecutorOptions,
    lock: LockFile,
    *,
    display: bool,
) -> tuple[Outcome, ...]:
    now = datetime.datetime.now().astimezone()
    provenance = collect_provenance(["iher-robot", *sys.argv[1:]], 0, now)
    del provenance["seed"]  # each cell has its own
    progress = ProgressTable(manifest.title, enabled=display)
    with options.make(cells, lock) as executor:
        runner = CellRunner(folder, executor, progress)
        if manifest.search is None:
            runner.prepare(chosen)
            for cell in cells:
                if cell not in chosen:  # the report shows it too
                    prepare_cell(folder, cell)
            folder.begin(manifest, provenance, [cell.identity for cell in cells])
            progress.print(
                f"{manifest.title}: {len(chosen)} cells, {executor.title}, in {folder.path}"
            )
            with progress:
                runner.submit(chosen)
                while runner.busy:
                    runner.wait()
        else:
            from iher_robot.experiments.search import SearchRun

            search = SearchRun(manifest, manifest.search, runner)
            folder.begin(manifest, provenance, search.identities)
            with progress:
                search.run()
    return tuple(runner.outcomes.values())


def _report(folder: ExperimentFolder) -> ReportResult | str:
    try:
        return report(folder.path)
    except UserError as error:
        return f"no report: {error}"
