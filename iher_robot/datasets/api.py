"""List, verify and export the data of runs: the application of ``iher-robot data``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path

from iher_robot.datasets.minari import MinariResult, write_minari
from iher_robot.datasets.parquet import ParquetResult, write_parquet
from iher_robot.datasets.run_reader import RunData, is_run
from iher_robot.datasets.selection import select
from iher_robot.datasets.summary import (
    EpisodeReport,
    RunLine,
    RunReport,
    describe_episode,
    describe_run,
    summarize_run,
)
from iher_robot.datasets.verify import Verification, check_run
from iher_robot.errors import UserError

DEFAULT_FOLDER = Path("runs")


def ls(folders: Sequence[Path] = ()) -> tuple[RunLine, ...]:
    """List the runs in some folders.

    Args:
        folders: Runs, or folders of runs; by default ``runs`` if it exists.

    Returns:
        A line for each run, damaged ones included.

    Raises:
        UserError: A folder does not exist, or cannot be read.
    """
    if not folders:
        folders = [DEFAULT_FOLDER] if DEFAULT_FOLDER.is_dir() else []
    lines = []
    for path in _find_runs(folders):
        with RunData(path) as run:
            lines.append(summarize_run(run))
    return tuple(lines)


def show(path: Path) -> RunReport:
    """Describe the data of a run.

    Args:
        path: The run's folder.

    Raises:
        UserError: There is no run, or a part of it is damaged.
    """
    with RunData(path) as run:
        return describe_run(run)


def show_episode(path: Path, index: int) -> EpisodeReport:
    """Show an episode tick by tick.

    Args:
        path: The run's folder.
        index: Index of the episode in the run, from 0.

    Raises:
        UserError: There is no such run or episode, or it is damaged.
    """
    with RunData(path) as run:
        return describe_episode(run, index)


def verify(paths: Iterable[Path]) -> Verification:
    """Check the checksum of every file of some runs, and that the parts of each belong together.

    Args:
        paths: The runs' folders.

    Returns:
        The problems.

    Raises:
        UserError: One is no run; nothing is checked.
    """
    found = Verification(0, 0, ())
    with ExitStack() as stack:
        for run in [stack.enter_context(RunData(path)) for path in paths]:
            found += check_run(run)
    return found


def export_minari(
    paths: Sequence[Path],
    *,
    dataset: str,
    root: Path | None = None,
    account: str = "all",
    overwrite: bool = False,
) -> MinariResult:
    """Export runs of one task to a Minari dataset.

    Args:
        paths: The runs' folders.
        dataset: Name of the dataset, such as ``"iher/push-v0"``.
        root: Folder of all datasets; Minari's own by default.
        account: Account of the episodes: ``motion``, ``evaluation`` or ``all``.
        overwrite: Replace an existing dataset.

    Returns:
        The size of the dataset.

    Raises:
        UserError: The runs are damaged or do not belong together, the extra ``data`` is missing,
            or the dataset exists or cannot be written. Nothing is written.
    """
    with select(paths, account) as selection:
        return write_minari(selection, dataset=dataset, root=root, overwrite=overwrite)


def export_parquet(
    paths: Sequence[Path],
    *,
    out: Path,
    account: str = "all",
    overwrite: bool = False,
) -> ParquetResult:
    """Export runs of one task to a Parquet file, one row for each tick.

    Args:
        paths: The runs' folders.
        out: The file.
        account: Account of the episodes: ``motion``, ``evaluation`` or ``all``.
        overwrite: Replace an existing file.

    Returns:
        The size of the file.

    Raises:
        UserError: The runs are damaged or do not belong together, the extra ``data`` is missing,
            or the file exists or cannot be written. Nothing is written.
    """
    with select(paths, account) as selection:
        return write_parquet(selection, out=out, overwrite=overwrite)


def _find_runs(folders: Iterable[Path]) -> list[Path]:
    found: list[Path] = []
    for folder in folders:
        try:
            inside = sorted(path for path in folder.iterdir() if path.is_dir())
        except OSError as error:
            raise UserError(f"cannot read folder {folder}: {error.strerror or error}") from error
        found += [folder] if is_run(folder) else filter(is_run, inside)
    return list(dict.fromkeys(found))
