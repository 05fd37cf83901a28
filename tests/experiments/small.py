"""Small experiments that take seconds, and their processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from iher_robot.config.yaml import format_yaml
from tests.small_runs import TINY

SETTINGS = dict(setting.split("=") for setting in TINY if "hidden" not in setting)
TINY_SETTINGS: Mapping[str, Any] = {key: int(value) for key, value in SETTINGS.items()} | {
    "learner.dynamics.hidden": [32, 32]
}
TINY_GRID: Mapping[str, Any] = {
    "tasks": ["reach"],
    "algos": ["her-matched"],
    "presets": ["paper"],
    "robot": "fetch-mocap",
    "settings": TINY_SETTINGS,
}
EPOCH_MINUTES = 0.0667


def write_manifest(path: Path, *grids: Mapping[str, Any], **head: Any) -> str:
    content = {"title": "Small", "grids": [dict(TINY_GRID) | dict(grid) for grid in grids]} | head
    path.write_text(format_yaml(content))
    return str(path)


def start(manifest: str, out: Path, *options: str) -> subprocess.Popen[str]:
    # Tests started in the background of a shell inherit that Ctrl-C is ignored.
    command = ["env", "--default-signal=INT", sys.executable, "-m", "iher_robot", "experiment"]
    command += [manifest, "--out", str(out)]
    return subprocess.Popen(
        [*command, *options], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def processes_of(out: Path) -> list[int]:
    """Processes of cells: their command lines name the folder of their run."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                arguments = (entry / "cmdline").read_bytes().decode().split("\0")
            except OSError:
                continue
            if any(argument.startswith(f"{out / 'cells'}{os.sep}") for argument in arguments):
                found.append(int(entry.name))
    return found


def epochs(out: Path, cell: str) -> list[int]:
    path = out / "cells" / cell / "metrics.jsonl"
    lines = path.read_text().splitlines() if path.exists() else []
    return [json.loads(line)["epoch"] for line in lines]


def process_count(out: Path, cell: str) -> int:
    """Number of processes of a run."""
    provenance = json.loads((out / "cells" / cell / "provenance.json").read_text())
    return 1 + len(provenance.get("resumed", ()))
