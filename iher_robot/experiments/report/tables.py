"""Tidy tables of an experiment: evaluations, runs, and the trials of a search."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from iher_robot.errors import UserError
from iher_robot.experiments.folder import NOT_BEGUN, ExperimentFolder, recorded_states
from iher_robot.experiments.report import formatting
from iher_robot.experiments.report.checks import check_evaluations, check_runs, no_table
from iher_robot.experiments.report.columns import EVALUATION_COLUMNS, RUN_COLUMNS
from iher_robot.experiments.report.rows import Row, rows_of
from iher_robot.storage.files.atomic import read_file, write_atomically

NEEDED = "pip install 'iher-robot[report]'"

# Columns of the table of trials before the value.
_TRIAL_COLUMNS = ("trial", "state")
_VALUE = len(_TRIAL_COLUMNS)


def require_pandas() -> Any:
    """Import pandas.

    Raises:
        UserError: It is not installed.
    """
    try:
        import pandas as pd
    except ImportError as error:
        raise UserError(f"tables need pandas (the extra 'report'): {NEEDED}") from error
    return pd


def write_tables(folder: ExperimentFolder, target: ExperimentFolder) -> None:
    """Write the tables of evaluations and runs as CSV and Parquet.

    Rows of runs without a folder, as among committed results, are taken from the existing tables.

    Args:
        folder: The experiment.
        target: Folder to write to; it may be the same.

    Raises:
        UserError: The existing tables are damaged, there are no cells yet, or the extra
            ``report`` is missing.
    """
    identities = folder.identities()
    if not identities:
        raise UserError(f"the experiment in {folder.path} has no runs yet")
    found = {identity.name: rows_of(folder, identity) for identity in identities}
    states = recorded_states(folder.runs_path)
    gone = [name for name, rows in found.items() if rows is None and states.get(name) != NOT_BEGUN]
    earlier = _read_earlier(folder) if gone else {}
    evaluations: list[Row] = []
    runs: list[Row] = []
    for identity in identities:
        of_cell, run = (
            found[identity.name]
            or earlier.get(identity.name)
            or ([], {"cell": identity.name, **identity.as_row(), "state": NOT_BEGUN})
        )
        evaluations += of_cell
        runs.append(run | {"rows": len(identities)})
    _write(target.evaluations_path, evaluations, EVALUATION_COLUMNS)
    _write(target.runs_path, runs, RUN_COLUMNS)


def read_tables(folder: ExperimentFolder) -> tuple[Any, Any]:
    """Read both tables from their CSV files.

    Args:
        folder: The experiment.

    Returns:
        Evaluations and runs, pandas DataFrames with the columns of `columns`.

    Raises:
        UserError: A table is missing or damaged, or lacks a cell of the experiment.
    """
    evaluations, runs = _read(folder)
    present = set(runs["cell"])
    for identity in folder.identities():
        if identity.name not in present:
            raise no_table(folder.runs_path, f"it has no row of cell {identity.name}")
    return evaluations, runs


def trial_rows(path: Path) -> list[list[str]]:
    """Rows of the table of trials: the header, then the best first; empty without a search.

    Args:
        path: The table.

    Raises:
        UserError: It is damaged.
    """
    if not path.exists():
        return []
    lines = read_file(path, "table of trials").decode(errors="replace").splitlines()
    table: list[list[str]] = [*csv.reader(lines)] or [[]]
    head, *rows = table
    widths = {len(row) for row in table}
    if head[:_VALUE] != [*_TRIAL_COLUMNS] or len(widths) > 1 or len(head) <= _VALUE:
        raise UserError(f"{path} is no table of trials; run the experiment again to rewrite it")
    sign = -1.0 if head[_VALUE] == "success-at-budget" else 1.0
    try:
        rows.sort(key=lambda row: sign * float(row[_VALUE]) if row[_VALUE] else math.inf)
    except ValueError as error:
        raise UserError(
            f"{path} has a value that is no number: {error}; run the experiment again to rewrite it"
        ) from error
    return [[formatting.plain(_short(text)) for text in row] for row in (head, *rows)]


def _read_earlier(folder: ExperimentFolder) -> dict[str, tuple[list[Row], Row]]:
    """Rows of the existing tables, by cell."""
    if not folder.runs_path.exists() and not folder.evaluations_path.exists():
        return {}
    evaluations, runs = map(_rows, _read(folder))
    return {
        run["cell"]: ([row for row in evaluations if row["cell"] == run["cell"]], run)
        for run in runs
    }


def _read(folder: ExperimentFolder) -> tuple[Any, Any]:
    """Read and check both tables; cells that are newer than the tables may be missing."""
    runs = _read_frame(folder.runs_path, RUN_COLUMNS)
    check_runs(_rows(runs), folder.identities(), folder.runs_path)
    evaluations = _read_frame(folder.evaluations_path, EVALUATION_COLUMNS)
    check_evaluations(_rows(evaluations), _rows(runs), folder.evaluations_path)
    return evaluations, runs


def _read_frame(path: Path, columns: Mapping[str, str]) -> Any:
    pd = require_pandas()
    text = read_file(path, "table of an experiment")
    if not text.endswith(b"\n"):
        raise no_table(path, "its last line is cut off")
    try:
        frame = pd.read_csv(
            io.BytesIO(text),
            dtype=columns,
            keep_default_na=False,  # a variant may have the name None
            na_values=[""],
        )
    except ValueError as error:
        raise no_table(path, " ".join(str(error).split())) from error
    missing = [name for name in columns if name not in frame]
    if missing:
        raise no_table(path, f"it has no column {missing[0]}")
    names = [name for name, kind in columns.items() if kind == "string"]
    return frame[list(columns)].assign(**{name: frame[name].fillna("") for name in names})


def _rows(frame: Any) -> list[Row]:
    """Rows, with None for missing values."""
    return list(frame.astype(object).where(frame.notna(), None).to_dict("records"))


def _write(path: Path, rows: Sequence[Row], columns: Mapping[str, str]) -> None:
    pd = require_pandas()
    frame = pd.DataFrame(rows, columns=list(columns)).astype(columns)
    text = frame.to_csv(index=False, lineterminator="\n").encode()
    write_atomically(path, lambda file: file.write(text))
    content = io.BytesIO()
    frame.to_parquet(content, index=False)
    data = content.getvalue()
    write_atomically(path.with_suffix(".parquet"), lambda file: file.write(data))


def _short(text: str) -> str:
    try:
        return f"{float(text):.4g}"
    except ValueError:
        return text
