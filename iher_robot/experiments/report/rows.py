"""Rows of an experiment's tables, from the folders of its runs."""

from __future__ import annotations

import math
import os
import shlex
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from iher_robot.config.robot import DEFAULT_DRIVER
from iher_robot.config.run import RunConfig, read_config
from iher_robot.errors import UserError
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.experiments.grid import Identity
from iher_robot.experiments.report.columns import EVALUATION_COLUMNS, VERSIONS
from iher_robot.storage.files.atomic import read_file
from iher_robot.storage.files.lock import is_locked
from iher_robot.storage.provenance import read_provenance
from iher_robot.storage.run_directory import RunDirectory
from iher_robot.storage.run_result import RunResult, read_result

Row = dict[str, Any]

# Numbers of a run without readable files.
_NO_NUMBERS: Mapping[str, Any] = {
    "epochs": 0,
    "evaluations": 0,
    "robot_minutes": 0.0,
    "wall_seconds": 0.0,
}


def rows_of(folder: ExperimentFolder, identity: Identity) -> tuple[list[Row], Row] | None:
    """Rows of a cell.

    A damaged run has the state ``damaged`` and no evaluations.

    Returns:
        Its evaluations and its run; None if it has no folder.
    """
    shared: Row = {"cell": identity.name, **identity.as_row()}
    failed = folder.failure(identity.name).exists()
    try:
        if folder.has_begun(identity.name):
            return _read(folder, identity, shared)
        if failed:
            return [], shared | dict(_NO_NUMBERS) | _state(folder, identity, None)
    except UserError as error:
        return [], shared | dict(_NO_NUMBERS) | {"state": "damaged", "reason": str(error)}
    return None


def _read(
    folder: ExperimentFolder, identity: Identity, shared: Row
) -> tuple[list[Row], dict[str, Any]]:
    directory = folder.run(identity.name)
    config = read_config(directory.config_path)
    shared = shared | {"budget_minutes": config.budget_minutes}
    rows = directory.read_metrics()
    result = read_result(directory.result_path)
    evaluations = list(_evaluations(shared, config, rows))
    run = shared | _state(folder, identity, result) | _run(directory, config, rows, result)
    return evaluations, run | {"evaluations": len(evaluations)}


def _state(folder: ExperimentFolder, identity: Identity, result: RunResult | None) -> Row:
    """State of a cell, and the reason of a failure."""
    if result is not None:
        return {"state": "finished"}
    if is_locked(folder.lock(identity.name)):
        return {"state": "running"}
    failure = folder.failure(identity.name)
    if failure.exists():
        reason = read_file(failure, "reason of a failure").decode(errors="replace").strip()
        return {"state": "failed", "reason": reason}
    return {"state": "interrupted"}


def _evaluations(
    shared: Mapping[str, Any], config: RunConfig, rows: list[dict[str, Any]]
) -> Iterator[Row]:
    simulated = config.driver == DEFAULT_DRIVER
    settings = config.evaluation
    count = settings.episodes if simulated else settings.robot_episodes
    for row in rows:
        if row.get("success") is not None:
            measured = {name: row.get(name) for name in EVALUATION_COLUMNS if name in row}
            yield {**measured, **shared, "evaluation_episodes": count}


def _run(
    directory: RunDirectory,
    config: RunConfig,
    rows: list[dict[str, Any]],
    result: RunResult | None,
) -> Row:
    last = rows[-1] if rows else {}
    success = [row["success"] for row in rows if row.get("success") is not None]
    found: Row = {
        "until_success": config.until_success,
        "epochs": last.get("epoch", 0),
        "robot_minutes": last.get("robot_minutes", 0.0),
        "success": success[-1] if success else math.nan,
        "wall_seconds": last.get("wall_seconds", 0.0),
    }
    if result is not None and result.final_episodes:
        found["final_successes"] = result.final_successes
        found["final_episodes"] = result.final_episodes
    return found | provenance_columns(directory)


def provenance_columns(directory: RunDirectory) -> dict[str, Any]:
    """Provenance of a run, as columns of the table of runs; empty if there is none.

    A run may have continued at another commit or on another machine: a column has each value
    once, in the order of the processes.

    Raises:
        UserError: The provenance file is damaged.
    """
    if not directory.provenance_path.exists():
        return {}
    first = read_provenance(directory.provenance_path)
    processes = [first, *first.get("resumed", ())]
    machines = [process.get("machine", {}) for process in processes]
    versions = [process.get("versions", {}) for process in processes]
    return {
        "command": shlex.join(["iher-robot", *map(_relative_to_cwd, first.get("command", ())[1:])]),
        "processes": len(processes),
        "commit": _each(processes, "commit"),
        "dirty": _any(process.get("dirty") for process in processes),
        **{name: _each(machines, name) for name in ("cpu", "cores", "system")},
        **{column: _each(versions, name) for column, name in VERSIONS.items()},
    }


def _relative_to_cwd(argument: str) -> str:
    """Make a path below the working directory relative: other machines have another one."""
    return str(argument).removeprefix(f"{Path.cwd()}{os.sep}")


def _each(processes: Iterable[Mapping[str, Any]], name: str) -> str | None:
    values = [process.get(name) for process in processes]
    return ", ".join(dict.fromkeys(str(value) for value in values if value is not None)) or None


def _any(values: Iterable[bool | None]) -> bool | None:
    known = [value for value in values if value is not None]
    return any(known) if known else None
