"""The table of a search's trials, as its report shows it."""

from __future__ import annotations

import csv
import math
from pathlib import Path

from iher_robot.errors import UserError
from iher_robot.experiments.report import formatting as words
from iher_robot.storage.files.atomic import read_file

_HEAD = ("trial", "state")
_VALUE = len(_HEAD)


def trial_rows(path: Path) -> list[list[str]]:
    """Rows of the table, its head first and then the best; nothing if there was no search.

    Raises:
        UserError: It is damaged.
    """
    if not path.exists():
        return []
    lines = read_file(path, "table of trials").decode(errors="replace").splitlines()
    table: list[list[str]] = [*csv.reader(lines)] or [[]]
    head, *rows = table
    widths = {len(row) for row in table}
    if head[:_VALUE] != [*_HEAD] or len(widths) > 1 or len(head) <= _VALUE:
        raise UserError(f"{path} is no table of trials; run the experiment again to make it")
    sign = -1.0 if head[_VALUE] == "success-at-budget" else 1.0
    try:
        rows.sort(key=lambda row: sign * float(row[_VALUE]) if row[_VALUE] else math.inf)
    except ValueError as error:
        raise UserError(
            f"{path} has a value that is no number: {error}; run the experiment again to make it"
        ) from error
    return [[words.plain(_short(text)) for text in row] for row in (head, *rows)]


def _short(text: str) -> str:
    try:
        return f"{float(text):.4g}"
    except ValueError:
        return text
