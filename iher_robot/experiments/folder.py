"""The folder of an experiment: what lies where, and how far each cell is."""

from __future__ import annotations

import csv
import io
import os
import shlex
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from iher_robot.errors import UserError
from iher_robot.experiments.grid import Identity
from iher_robot.experiments.manifest import Manifest
from iher_robot.experiments.metadata import cells_of, read_origin, write_origin
from iher_robot.storage.files.atomic import read_file
from iher_robot.storage.files.lock import LockFile, read_note, wait_for_lock
from iher_robot.storage.run_directory import RunDirectory

NOT_BEGUN = "not begun"
"""State of a cell that has no run."""


class ExperimentFolder:
    """Paths of an experiment.

    Args:
        path: Its folder.
        origin: What it is; what the file there says by default.
    """

    def __init__(self, path: Path, origin: Mapping[str, Any] | None = None) -> None:
        self.path = path
        self._origin = origin
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

    def lock(self, name: str) -> Path:
        """Held while a process of a cell runs."""
        return self.log(name).with_suffix(".lock")

    def failure(self, name: str) -> Path:
        """Why the last process of a cell failed, if it did."""
        return self.log(name).with_suffix(".failed")

    def hold(self) -> LockFile:
        """Make the folder and hold it for this process.

        Raises:
            FileHeld: Another experiment runs there.
            UserError: The folder cannot be made.
        """
        self._make()
        pid = read_note(self._lock_path).get("pid")
        who = f" (process {pid})" if pid else ""
        held = LockFile(
            self._lock_path,
            f"another experiment runs in {self.path}{who}; wait for it, or choose another --out",
        )
        held.write()
        return held

    def hold_report(self, patience_s: float = 30.0) -> LockFile:
        """Make the folder and hold its tables and report, once nobody else writes them.

        Raises:
            FileHeld: Somebody still does.
            UserError: The folder cannot be made.
        """
        self._make()
        in_use = (
            f"another process writes tables and report of {self.path}; wait for it, then "
            f"iher-robot report {shlex.quote(str(self.path))}"
        )
        return wait_for_lock(self.path / "report.lock", in_use, patience_s)

    def _make(self) -> None:
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(
                f"cannot make experiment folder {self.path}: {error.strerror or error}; choose "
                "another with --out"
            ) from error

    def read_origin(self) -> dict[str, Any]:
        """What the experiment is, see `origin.read_origin`; empty if nothing is known of it yet.

        Raises:
            UserError: The file is damaged.
        """
        return read_origin(self.origin_path) if self._origin is None else dict(self._origin)

    def as_it_is_now(self, path: Path | None = None) -> ExperimentFolder:
        """The same, with the cells that it has now, whatever is begun meanwhile.

        Args:
            path: Another folder for it; this one by default.
        """
        return ExperimentFolder(path or self.path, self.read_origin())

    def begin(
        self, manifest: Manifest, provenance: Mapping[str, Any], cells: Iterable[Identity]
    ) -> None:
        """Keep what the experiment is, and where this process of it comes from.

        Raises:
            UserError: Cells have been run here that are not of this experiment.
        """
        before = self.read_origin()
        cells = tuple(cells)
        if before:
            self._require_kept(cells_of(before), cells)
        write_origin(
            self.origin_path,
            {
                "title": manifest.title,
                "description": manifest.description,
                "manifest": manifest.origin,
                "search": manifest.search is not None,
                "processes": [*before.get("processes", []), dict(provenance)],
                "cells": [identity.as_row() for identity in cells],
            },
        )

    def _require_kept(self, before: Iterable[Identity], cells: Iterable[Identity]) -> None:
        """A report that leaves out what was run might leave out what did not please."""
        names = {identity.name for identity in cells}
        told = states_told(self.runs_path)
        lost = [
            identity.name
            for identity in before
            if identity.name not in names
            and (self.has_begun(identity.name) or told.get(identity.name, NOT_BEGUN) != NOT_BEGUN)
        ]
        if lost:
            more = f" and {len(lost) - 3} more" if len(lost) > 3 else ""
            raise UserError(
                f"{self.path} has runs that the manifest does not have any more: "
                f"{', '.join(lost[:3])}{more}; put them back into it, or choose another --out"
            )

    def has_begun(self, name: str) -> bool:
        """Whether the run of a cell is there."""
        config = self.run(name).config_path
        return config.exists() and config.stat().st_size > 0

    def add_cells(self, cells: Iterable[Identity]) -> None:
        """Keep that there are more cells."""
        origin = self.read_origin()
        rows = [identity.as_row() for identity in cells]
        new = [row for row in rows if row not in origin["cells"]]
        write_origin(self.origin_path, origin | {"cells": [*origin["cells"], *new]})

    def identities(self) -> tuple[Identity, ...]:
        """The cells that the experiment has begun with.

        Raises:
            UserError: The file that tells of them is damaged or missing.
        """
        origin = self.read_origin()
        if not origin:
            raise UserError(f"there is no experiment in {self.path}: it has no experiment.json")
        return cells_of(origin)


def states_told(path: Path) -> dict[str, str]:
    """State of each cell in a table of runs, empty if there is none; no extra is needed."""
    if not path.exists():
        return {}
    text = read_file(path, "table of an experiment").decode(errors="replace")
    rows = csv.DictReader(io.StringIO(text, newline=""))
    return {str(row.get("cell")): str(row.get("state")) for row in rows}


def hold_cell(path: Path, give_up: Callable[[], bool], patience_s: float = 60.0) -> LockFile:
    """Hold a cell, once an earlier process of it has ended.

    Args:
        path: Its lock.
        give_up: Whether nobody wants it any more.
        patience_s: How long to wait for that process.

    Raises:
        FileHeld: It goes on.
    """
    return wait_for_lock(path, f"an earlier process of {path.stem} still runs", patience_s, give_up)


def tail(path: Path, lines: int = 5) -> list[str]:
    """Last lines of a log that say something."""
    try:
        with path.open("rb") as file:
            file.seek(max(0, os.fstat(file.fileno()).st_size - 8192))
            text = file.read().decode(errors="replace")
    except OSError:
        return []
    return [line for line in text.splitlines() if line.strip()][-lines:]
