"""Tables, figures and report of an experiment: the application behind ``iher-robot report``."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from pathlib import Path

from iher_robot.callable_module import make_module_callable
from iher_robot.errors import UserError
from iher_robot.experiments.folder import ExperimentFolder


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

    Where its runs are gone, as in a folder of committed results, the tables that are there are
    taken as they are.

    Args:
        folder: Folder of the experiment.
        out: Folder to write report and figures to; that of the experiment by default.

    Raises:
        UserError: There is no experiment, something of it is damaged, or the extra ``report`` is
            missing.
    """
    from iher_robot.experiments.pages import write_report
    from iher_robot.experiments.table import write_tables

    experiment = ExperimentFolder(folder)
    if not experiment.read_origin():
        raise UserError(f"there is no experiment in {folder}: it has no experiment.json")
    if experiment.cells_path.is_dir():
        write_tables(experiment)
    now = datetime.datetime.now().astimezone()
    markdown, html = write_report(experiment, out or folder, f"{now:%Y-%m-%d %H:%M:%S %z}")
    return ReportResult(markdown, html, experiment.evaluations_path)


make_module_callable(__name__)
