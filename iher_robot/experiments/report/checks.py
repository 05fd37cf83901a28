"""Validation of an experiment's tables, so that damaged ones are not reported as results."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from iher_robot.errors import UserError
from iher_robot.experiments.folder import NOT_BEGUN
from iher_robot.experiments.grid import Identity

Row = Mapping[str, Any]

STATES = ("finished", "running", "interrupted", "failed", "damaged", NOT_BEGUN)
"""Values of the column ``state``."""

_REQUIRED_OF_A_RUN = ("epochs", "evaluations", "robot_minutes", "wall_seconds")
_REQUIRED_OF_AN_EVALUATION = (
    *("budget_minutes", "epoch", "robot_minutes", "success", "evaluation_episodes"),
)


def no_table(path: Path, what: str) -> UserError:
    """Build the error for a damaged table."""
    return UserError(
        f"{path} is no table of an experiment, or damaged: {what}; restore both tables from a "
        "copy, or remove both and run iher-robot report where the runs are"
    )


def check_runs(rows: Sequence[Row], identities: Iterable[Identity], path: Path) -> None:
    """Check the table of runs; cells that are newer than the table may be missing.

    Args:
        rows: Its rows, with None for missing values.
        identities: The cells of the experiment.
        path: Its file, for messages.

    Raises:
        UserError: A check fails.
    """
    if not rows:
        raise no_table(path, "it has no rows")
    _check_cells(rows, identities, path)
    name, count = Counter(row["cell"] for row in rows).most_common(1)[0]
    if count > 1:
        raise no_table(path, f"it has {count} rows of cell {name}, allowed: one")
    for row in rows:
        _check(row, "rows", row["rows"] == len(rows), f"{len(rows)}, the number of rows", path)
        _check(row, "state", row["state"] in STATES, "one of " + ", ".join(STATES), path)
        if row["state"] != NOT_BEGUN:
            _check_begun(row, path)


def _check_begun(row: Row, path: Path) -> None:
    for name in _REQUIRED_OF_A_RUN:
        _check(row, name, _is_count(row[name]), "0 or more", path)
    evaluated = row["evaluations"] > 0
    rate = row["success"]
    _check(row, "success", _is_rate(rate) if evaluated else rate is None, "0 to 1", path)
    if evaluated:
        _check(row, "budget_minutes", _is_positive(row["budget_minutes"]), "more than 0", path)
    until = row["until_success"]
    _check(row, "until_success", until is None or _is_rate(until), "0 to 1", path)
    final, episodes = row["final_successes"], row["final_episodes"]
    known = final is not None and episodes is not None and 0 <= final <= episodes
    _check(row, "final_successes", known or final is episodes is None, "0 to final_episodes", path)


def check_evaluations(rows: Sequence[Row], runs: Sequence[Row], path: Path) -> None:
    """Check the table of evaluations.

    Args:
        rows: Its rows, with None for missing values.
        runs: Rows of the table of runs, checked.
        path: Its file, for messages.

    Raises:
        UserError: A check fails.
    """
    _check_cells(rows, [_identity(run) for run in runs], path)
    for row in rows:
        for name in _REQUIRED_OF_AN_EVALUATION:
            _check(row, name, row[name] is not None, "a number", path)
        _check(row, "success", _is_rate(row["success"]), "0 to 1", path)
        _check(row, "robot_minutes", _is_positive(row["robot_minutes"]), "more than 0", path)
        _check(row, "evaluation_episodes", row["evaluation_episodes"] > 0, "more than 0", path)
    twice = [key for key, n in Counter((r["cell"], r["epoch"]) for r in rows).items() if n > 1]
    if twice:
        raise no_table(path, "it has two rows of cell {} and epoch {}".format(*twice[0]))
    counts = Counter(row["cell"] for row in rows)
    for run in runs:
        expected, found = run["evaluations"] or 0, counts[run["cell"]]
        if expected != found:
            raise no_table(
                path,
                f"it has {found} rows of cell {run['cell']}, where the table of runs has "
                f"{expected}",
            )


def _check_cells(rows: Iterable[Row], identities: Iterable[Identity], path: Path) -> None:
    known = {identity.name: identity for identity in identities}
    for row in rows:
        identity = known.get(row["cell"])
        if identity is None:
            raise no_table(path, f"it has a row of {row['cell']!r}, no cell of the experiment")
        for name, value in identity.as_row().items():
            _check(row, name, row[name] == value, repr(value), path)


def _identity(run: Row) -> Identity:
    return Identity(**{name: run[name] for name in Identity.__dataclass_fields__})


def _check(row: Row, name: str, holds: bool, allowed: str, path: Path) -> None:
    if not holds:
        value = row[name]
        found = "missing" if value is None else repr(value)
        raise no_table(path, f"{name} of cell {row['cell']} is {found}, allowed: {allowed}")


def _is_rate(value: float | None) -> bool:
    return value is not None and 0 <= value <= 1


def _is_positive(value: float | None) -> bool:
    return value is not None and 0 < value < math.inf


def _is_count(value: float | None) -> bool:
    return value is not None and 0 <= value < math.inf
