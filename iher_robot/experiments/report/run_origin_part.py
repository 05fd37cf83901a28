"""Where a run comes from: command, commits, machines and versions of all of its processes."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from iher_robot.experiments.report.columns import VERSIONS
from iher_robot.storage.provenance import read_provenance
from iher_robot.storage.run_directory import RunDirectory


def origin_of(directory: RunDirectory) -> dict[str, Any]:
    """Columns of the table of runs; empty if nothing is known.

    A run that went on may have done so at another commit or on another machine: a column has each
    value once, in the order of the processes.

    Raises:
        UserError: What is known is damaged.
    """
    if not directory.provenance_path.exists():
        return {}
    first = read_provenance(directory.provenance_path)
    processes = [first, *first.get("resumed", ())]
    machines = [process.get("machine", {}) for process in processes]
    versions = [process.get("versions", {}) for process in processes]
    return {
        "command": shlex.join(["iher-robot", *map(_from_here, first.get("command", ())[1:])]),
        "processes": len(processes),
        "commit": _each(processes, "commit"),
        "dirty": _any(process.get("dirty") for process in processes),
        **{name: _each(machines, name) for name in ("cpu", "cores", "system")},
        **{column: _each(versions, name) for column, name in VERSIONS.items()},
    }


def _from_here(word: str) -> str:
    """A path below the working folder, from there: it lies elsewhere on another machine."""
    return str(word).removeprefix(f"{Path.cwd()}{os.sep}")


def _each(processes: Iterable[Mapping[str, Any]], name: str) -> str | None:
    values = [process.get(name) for process in processes]
    return ", ".join(dict.fromkeys(str(value) for value in values if value is not None)) or None


def _any(values: Iterable[bool | None]) -> bool | None:
    known = [value for value in values if value is not None]
    return any(known) if known else None
