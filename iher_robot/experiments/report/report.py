"""Tables, figures and report of an experiment: the application behind ``iher-robot report``."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from pathlib import Path

from iher_robot.errors import UserError
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.experiments.metadata import write_origin
from iher_robot.storage.files.atomic import read_file, write_atomically


@dataclass(frozen=True)
class ReportResult:
    """What was written.

    Attributes:
        markdown: The report.
        html: The same as one file, with its pictures in it.
        table: The table of evaluations.
    """

    markdown: Path
    html: Path
    table: Path

    def summary(self) -> str:
        """The files."""
        return f"report  {self.html} and {self.markdown.name}\ntable   {self.table}"


def report(folder: Path, *, out: Path | None = None) -> ReportResult:
    """Write tables, figures and report of an experiment, finished or not.

    Where its runs are gone, as in a folder of committed results, their rows are taken from the
    tables that are there.

    Args:
        folder: Folder of the experiment.
        out: Folder to write to, with all that it takes to make the report again there; nothing in
            `folder` is changed then. That of the experiment by default.

    Raises:
        UserError: There is no experiment, something of it is damaged, the extra ``report`` is
            missing, or another experiment is in `out`.
    """
    from iher_robot.experiments.report.pages import write_report
    from iher_robot.experiments.report.tables import write_tables

    experiment = ExperimentFolder(folder).as_it_is_now()
    if not experiment.read_origin():
        raise UserError(f"there is no experiment in {folder}: it has no experiment.json")
    elsewhere = out is not None and out.resolve() != folder.resolve()
    target = experiment.as_it_is_now(out) if elsewhere else experiment
    with target.hold_report():
        if elsewhere:
            _copy(experiment, target)
        write_tables(experiment, target)
        now = datetime.datetime.now().astimezone()
        markdown, html = write_report(target, target.path, f"{now:%Y-%m-%d %H:%M:%S %z}")
    return ReportResult(markdown, html, target.evaluations_path)


def _copy(experiment: ExperimentFolder, target: ExperimentFolder) -> None:
    """Write down elsewhere what the experiment is, and its trials."""
    there = ExperimentFolder(target.path).read_origin()
    origin = experiment.read_origin()
    if target.cells_path.exists() or (there and there["processes"][:1] != origin["processes"][:1]):
        raise UserError(
            f"{target.path} is the folder of another experiment; choose another with --out"
        )
    write_origin(target.origin_path, origin)
    if experiment.trials_path.exists():
        trials = read_file(experiment.trials_path, "table of trials")
        write_atomically(target.trials_path, lambda file: file.write(trials))
