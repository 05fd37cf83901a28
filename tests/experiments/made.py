"""Experiments whose runs are created without training."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.experiments.grid import Cell, expand
from iher_robot.experiments.manifest import read_manifest
from iher_robot.experiments.report.report import report
from iher_robot.storage.run_result import RunResult, write_result
from tests.experiments.small import write_manifest
from tests.run_folders import make_run

PROVENANCE: Mapping[str, Any] = {"command": ["iher-robot", "experiment", "m.yaml"]}
NAMES = tuple(f"reach-iher-default-seed{seed}" for seed in range(3))


def make_cell(folder: ExperimentFolder, name: str, rates: Sequence[float], *, done: bool) -> None:
    """Create the folder of a run after a number of evaluations, one per robot minute."""
    run = folder.run(name)
    make_run(run.path, seed=int(name[-1]), budget_minutes=4.0)
    for epoch, rate in enumerate(rates, start=1):
        run.append_metrics(
            {"epoch": epoch, "robot_minutes": float(epoch), "success": rate, "wall_seconds": 9.0}
        )
    if done:
        result = RunResult(len(rates), float(len(rates)), 4.0, rates[-1], 90, 100, 40.0)
        write_result(run.result_path, result)


def make_cells(folder: Path, seeds: Sequence[int] = (0, 1, 2), **grid: Any) -> tuple[Cell, ...]:
    grid = {"algos": ["iher"], "presets": ["default"], "settings": {}, "budgets": [4]} | grid
    return expand(read_manifest(write_manifest(folder / "m.yaml", grid | {"seeds": list(seeds)})))


def begin(folder: ExperimentFolder, *args: Any, **kwargs: Any) -> tuple[Cell, ...]:
    """Write the metadata as an experiment does, without running cells."""
    cells = make_cells(folder.path.parent, *args, **kwargs)
    manifest = read_manifest(str(folder.path.parent / "m.yaml"))
    with folder.hold():
        folder.begin(manifest, PROVENANCE, [cell.identity for cell in cells])
    return cells


def make_experiment(path: Path) -> ExperimentFolder:
    """Three seeds: one finished, one interrupted, one not begun."""
    folder = ExperimentFolder(path)
    begin(folder)
    make_cell(folder, NAMES[0], (0.1, 0.95), done=True)
    make_cell(folder, NAMES[1], (0.2, 0.3, 0.4), done=False)
    return folder


def commit(folder: ExperimentFolder) -> ExperimentFolder:
    """Copy the files that a report needs."""
    report(folder.path)
    small = ExperimentFolder(folder.path.parent / "committed")
    small.path.mkdir()
    for path in (folder.metadata_path, folder.evaluations_path, folder.runs_path):
        shutil.copy(path, small.path)
    return small


def unsealed(path: Path) -> dict[str, Any]:
    """Content of a sealed file, without its seal."""
    return {key: value for key, value in json.loads(path.read_text()).items() if key != "sha256"}
