"""Looks into the folder of a cell before it is run."""

from __future__ import annotations

import shutil

from iher_robot.config.run import RunConfig, read_config
from iher_robot.errors import UserError
from iher_robot.experiments.differences_part import differences
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.experiments.grid import Cell
from iher_robot.storage.run_result import read_result

# What a run that was ended before its settings were written leaves.
_LEFTOVERS = {"config.yaml", ".config.yaml.tmp"}


def prepare(folder: ExperimentFolder, cell: Cell) -> str:
    """Look into the folder of a cell before it is run.

    Returns:
        ``"finished"``, ``"interrupted"`` or ``"new"``.

    Raises:
        UserError: A run with other settings is there, or its settings are damaged.
    """
    run = folder.run(cell.name)
    if not run.path.exists():
        return "new"
    if not run.config_path.exists() or not run.config_path.read_bytes():
        if {entry.name for entry in run.path.iterdir()} <= _LEFTOVERS:
            shutil.rmtree(run.path)
            return "new"
        raise UserError(f"{run.path} is no run of this experiment: move it away")
    run.check_config()
    there = read_config(run.config_path)
    if differences(there, cell.config):
        raise UserError(
            f"{run.path} was run with {_told(there, cell.config)}; "
            "give the experiment another --out, or move that folder away"
        )
    return "interrupted" if read_result(run.result_path) is None else "finished"


def _told(there: RunConfig, wanted: RunConfig) -> str:
    found = differences(there, wanted)
    told = [
        f"{key} {was!r}, where the manifest has {now!r}"
        for key, (was, now) in list(found.items())[:3]
    ]
    more = f" and {len(found) - 3} more" if len(found) > 3 else ""
    return "; ".join(told) + more
