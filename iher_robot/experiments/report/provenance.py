"""Provenance of an experiment in its report: state, versions, machines, commands, runs."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from iher_robot.experiments.folder import NOT_BEGUN
from iher_robot.experiments.report import formatting
from iher_robot.experiments.report.columns import VERSIONS

_WIDTH_OF_A_NAME = 60
_WIDTH_OF_A_COMMIT = 10
_WITHOUT_NUMBERS = (NOT_BEGUN, "damaged")

Row = Mapping[Any, Any]


def state(rows: Sequence[Row]) -> str:
    """A sentence with the number of finished runs."""
    finished = sum(row["state"] == "finished" for row in rows)
    if finished == len(rows):
        return f"All {len(rows)} runs have finished."
    others = [row["state"] for row in rows if row["state"] != "finished"]
    counts = ", ".join(f"{others.count(name)} {name}" for name in dict.fromkeys(others))
    return (
        f"**{finished} of {len(rows)} runs have finished**, {counts}. The report "
        "includes what the others have measured so far."
    )


def facts(metadata: Mapping[str, Any], rows: Sequence[Row]) -> list[str]:
    """Manifest, commits, versions, machines and robots."""
    known = [row for row in rows if row["commit"]]
    dirty = any(row["dirty"] is True for row in known)
    machines = (
        f"{_short(row['cpu'])}, {row['cores']} cores, {_short(row['system'])}" for row in known
    )
    versions = (
        ", ".join(f"{name} {row[column]}" for column, name in VERSIONS.items() if row[column])
        for row in known
    )
    return [
        f"Manifest: {formatting.plain(metadata['manifest'])}",
        f"Commit: {_each(row['commit'] for row in known)}" + ", with changes" * dirty,
        f"Versions: {_each(versions)}",
        f"Machine: {_each(machines)}; one core a run",
        f"Robot: {_each(row['robot'] for row in rows)}",
    ]


def commands(metadata: Mapping[str, Any]) -> list[str]:
    """Commands of the experiment."""
    return list(dict.fromkeys(shlex.join(process["command"]) for process in metadata["processes"]))


def run_row(row: Row) -> list[str]:
    """A run in the table of runs: name, state, robot minutes, wall clock, commit, command."""
    name, state_of_run = formatting.plain(row["cell"]), row["state"]
    if row["reason"]:
        state_of_run += f": {formatting.plain(row['reason'])}"
    if row["state"] in _WITHOUT_NUMBERS or not row["commit"]:
        return [name, state_of_run, "", "", "", ""]
    cut = [commit[:_WIDTH_OF_A_COMMIT] for commit in row["commit"].split(", ")]
    return [
        name,
        state_of_run,
        formatting.minutes(row["robot_minutes"]),
        formatting.duration(row["wall_seconds"]),
        ", ".join(cut) + ", with changes" * (row["dirty"] is True),
        formatting.as_code(row["command"]) + _resumed(row["processes"] - 1),
    ]


def _resumed(times: int) -> str:
    return "" if times < 1 else f", resumed {'once' if times == 1 else f'{times} times'}"


def _each(values: Iterable[str]) -> str:
    return formatting.plain("; ".join(dict.fromkeys(values))) or formatting.UNKNOWN


def _short(names: str) -> str:
    """Shorten each of several names of a machine."""
    return ", ".join(name[:_WIDTH_OF_A_NAME] for name in names.split(", "))
