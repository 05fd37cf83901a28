"""Write tables, figures and report: the application behind ``iher-robot report``."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from pathlib import Path

from iher_robot.config.run import read_config
from iher_robot.errors import UserError
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.experiments.metadata import write_metadata
from iher_robot.storage.files.atomic import read_file, write_atomically


@dataclass(frozen=True)
class ReportResult:
    """Files of a report.

    Attributes:
        markdown: The report.
        html: The same as one file with embedded figures.
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

    Rows of runs without a folder, as among committed results, are taken from the existing tables.
    The settings of each run are copied to ``configs``, so that a reader can run it again.

    Args:
        folder: Folder of the experiment.
        out: Folder to write to, with everything that a later report needs; nothing in `folder` is
            changed then. The experiment's own folder by default.

    Raises:
        UserError: There is no experiment, a file of it is damaged, the extra ``report`` is
            missing, or `out` has another experiment.
    """
    from iher_robot.experiments.report.pages import write_report
    from iher_robot.experiments.report.tables import write_tables

    experiment = ExperimentFolder(folder).snapshot()
    if not experiment.read_metadata():
        raise UserError(f"there is no experiment in {folder}: it has no experiment.json")
    elsewhere = out is not None and out.resolve() != folder.resolve()
    target = experiment.snapshot(out) if elsewhere else experiment
    with target.hold_report():
        if elsewhere:
            _copy(experiment, target)
        write_tables(experiment, target)
        _copy_configs(experiment, target)
        now = datetime.datetime.now().astimezone()
        markdown, html = write_report(target, target.path, f"{now:%Y-%m-%d %H:%M:%S %z}")
    return ReportResult(markdown, html, target.evaluations_path)


def _copy(experiment: ExperimentFolder, target: ExperimentFolder) -> None:
    """Copy metadata and trials to another folder."""
    existing = ExperimentFolder(target.path).read_metadata()
    metadata = experiment.read_metadata()
    is_other = existing and existing["processes"][:1] != metadata["processes"][:1]
    if target.cells_path.exists() or is_other:
        raise UserError(
            f"{target.path} is the folder of another experiment; choose another with --out"
        )
    write_metadata(target.metadata_path, metadata)
    if experiment.trials_path.exists():
        _copy_file(experiment.trials_path, target.trials_path, "table of trials")


def _copy_configs(experiment: ExperimentFolder, target: ExperimentFolder) -> None:
    """Copy the settings of each run to ``configs``; damaged ones are left out."""
    for identity in experiment.identities():
        name = identity.name
        begun = experiment.has_begun(name)
        path = experiment.run(name).config_path if begun else experiment.config(name)
        if not path.exists() or path == target.config(name):
            continue
        try:
            read_config(path)
        except UserError:  # the table of runs says so
            continue
        target.configs_path.mkdir(exist_ok=True)
        _copy_file(path, target.config(name), "config file")


def _copy_file(source: Path, target: Path, kind: str) -> None:
    content = read_file(source, kind)
    write_atomically(target, lambda file: file.write(content))
