"""The folder of an experiment: what lies where, and how far each cell is."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from iher_robot.config import RunConfig, read_config
from iher_robot.durable_file import read_file, write_atomically
from iher_robot.errors import UserError
from iher_robot.experiments.cells import Cell, Identity
from iher_robot.experiments.differences import differences
from iher_robot.experiments.manifest import Manifest
from iher_robot.held_file import FileHeld, HeldFile, read_note
from iher_robot.run_directory import RunDirectory
from iher_robot.run_result import read_result
from iher_robot.sealed_json import open_line, seal

# What a run that was ended before its settings were written leaves.
_LEFTOVERS = {"config.yaml", ".config.yaml.tmp"}


class ExperimentFolder:
    """Paths of an experiment.

    Args:
        path: Its folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.cells_path = path / "cells"
        self.logs_path = path / "logs"
        self.figures_path = path / "figures"
        self.origin_path = path / "experiment.json"
        self.evaluations_path = path / "evaluations.csv"
        self.runs_path = path / "runs.csv"
        self.trials_path = path / "trials.csv"
        self.study_path = path / "search.sqlite"
        self._lock_path = path / "experiment.lock"

    def run(self, name: str) -> RunDirectory:
        """Folder of a cell's run, which may not be there yet."""
        return RunDirectory(self.cells_path / name)

    def log(self, name: str) -> Path:
        """What the processes of a cell printed."""
        return self.logs_path / f"{name}.log"

    def hold(self) -> HeldFile:
        """Make the folder and hold it for this process.

        Raises:
            FileHeld: Another experiment runs there.
            UserError: The folder cannot be made.
        """
        try:
            for folder in (self.cells_path, self.logs_path):
                folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(
                f"cannot make experiment folder {self.path}: {error.strerror or error}; choose "
                "another with --out"
            ) from error
        pid = read_note(self._lock_path).get("pid")
        who = f" (process {pid})" if pid else ""
        held = HeldFile(
            self._lock_path,
            f"another experiment runs in {self.path}{who}; wait for it, or choose another --out",
        )
        held.write()
        return held

    def read_origin(self) -> dict[str, Any]:
        """What the experiment is; empty if nothing is known of it yet.

        Raises:
            UserError: The file is damaged.
        """
        path = self.origin_path
        if not path.exists():
            return {}
        return open_line(read_file(path, "experiment file"), path, "experiment file")

    def begin(
        self, manifest: Manifest, provenance: Mapping[str, Any], cells: Iterable[Identity]
    ) -> None:
        """Keep what the experiment is, and where this process of it comes from."""
        before = self.read_origin().get("processes", [])
        self._write_origin(
            {
                "title": manifest.title,
                "description": manifest.description,
                "manifest": manifest.origin,
                "search": manifest.search is not None,
                "processes": [*before, dict(provenance)],
                "cells": [identity.as_row() for identity in cells],
            }
        )

    def add_cells(self, cells: Iterable[Identity]) -> None:
        """Keep that there are more cells."""
        origin = self.read_origin()
        rows = [identity.as_row() for identity in cells]
        new = [row for row in rows if row not in origin["cells"]]
        self._write_origin(origin | {"cells": [*origin["cells"], *new]})

    def _write_origin(self, origin: Mapping[str, Any]) -> None:
        text = json.dumps(seal(origin), indent=1, allow_nan=False) + "\n"
        write_atomically(self.origin_path, lambda file: file.write(text.encode()))

    def identities(self) -> tuple[Identity, ...]:
        """The cells that the experiment has begun with.

        Raises:
            UserError: The file that tells of them is damaged or missing.
        """
        origin = self.read_origin()
        if not origin:
            raise UserError(f"there is no experiment in {self.path}: it has no experiment.json")
        return tuple(Identity(**identity) for identity in origin["cells"])


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


def hold_cell(path: Path, give_up: Callable[[], bool], patience_s: float = 60.0) -> HeldFile:
    """Hold a cell, once an earlier process of it has ended.

    Args:
        path: Its lock.
        give_up: Whether nobody wants it any more.
        patience_s: How long to wait for that process.

    Raises:
        FileHeld: It goes on.
    """
    deadline = time.monotonic() + patience_s
    while True:
        try:
            return HeldFile(path, f"an earlier process of {path.stem} still runs")
        except FileHeld:
            if time.monotonic() > deadline or give_up():
                raise
            time.sleep(0.1)


def _told(there: RunConfig, wanted: RunConfig) -> str:
    found = differences(there, wanted)
    told = [
        f"{key} {was!r}, where the manifest has {now!r}"
        for key, (was, now) in list(found.items())[:3]
    ]
    more = f" and {len(found) - 3} more" if len(found) > 3 else ""
    return "; ".join(told) + more


def tail(path: Path, lines: int = 5) -> list[str]:
    """Last lines of a log that say something."""
    try:
        with path.open("rb") as file:
            file.seek(max(0, os.fstat(file.fileno()).st_size - 8192))
            text = file.read().decode(errors="replace")
    except OSError:
        return []
    return [line for line in text.splitlines() if line.strip()][-lines:]
