"""Folder of an experiment: paths, locks, cells and their states."""

from __future__ import annotations

import csv
import io
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from iher_robot.errors import UserError
from iher_robot.experiments.grid import Identity
from iher_robot.experiments.manifest import Manifest
from iher_robot.experiments.metadata import cells_of, read_metadata, write_metadata
from iher_robot.storage.files.atomic import read_file
from iher_robot.storage.files.lock import LockFile, read_note, wait_for_lock
from iher_robot.storage.run_directory import RunDirectory

NOT_BEGUN = "not begun"
"""State of a cell that has no run."""


class ExperimentFolder:
    """Folder of an experiment.

    Args:
        path: The folder.
        metadata: Contents of ``experiment.json``; read from the folder by default.
    """

    def __init__(self, path: Path, metadata: Mapping[str, Any] | None = None) -> None:
        self.path = path
        self._metadata = metadata
        self.cells_path = path / "cells"
        self.configs_path = path / "configs"
        self.logs_path = path / "logs"
        self.figures_path = path / "figures"
        self.metadata_path = path / "experiment.json"
        self.evaluations_path = path / "evaluations.csv"
        self.runs_path = path / "runs.csv"
        self.trials_path = path / "trials.csv"
        self.study_path = path / "search.sqlite"
        self._lock_path = path / "experiment.lock"

    def run(self, name: str) -> RunDirectory:
        """Folder of a cell's run, which may not exist yet."""
        return RunDirectory(self.cells_path / name)

    def config(self, name: str) -> Path:
        """Settings of a cell, for ``iher-robot train --config``."""
        return self.configs_path / f"{name}.yaml"

    def log(self, name: str) -> Path:
        """Output of the processes of a cell."""
        return self.logs_path / f"{name}.log"

    def lock(self, name: str) -> Path:
        """Lock that a running process of a cell holds."""
        return self.log(name).with_suffix(".lock")

    def failure(self, name: str) -> Path:
        """File with the reason why the last process of a cell failed."""
        return self.log(name).with_suffix(".failed")

    def hold(self) -> LockFile:
        """Create the folder and lock it for this process.

        Raises:
            FileHeld: Another experiment runs there.
            UserError: The folder cannot be created.
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
        """Create the folder and lock its tables and report.

        Args:
            patience_s: Longest wait for another process that writes them, s.

        Raises:
            FileHeld: Another process still writes them.
            UserError: The folder cannot be created.
        """
        self._make()
        in_use = (
            f"another process writes tables and report of {self.path}; wait for it, then run "
            f"iher-robot report {shlex.quote(str(self.path))}"
        )
        return wait_for_lock(self.path / "report.lock", in_use, patience_s)

    def _make(self) -> None:
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(
                f"cannot create experiment folder {self.path}: {error.strerror or error}; choose "
                "another with --out"
            ) from error

    def read_metadata(self) -> dict[str, Any]:
        """Metadata of the experiment, see `metadata.read_metadata`; empty if there is none yet.

        Raises:
            UserError: The file is damaged.
        """
        if self._metadata is not None:
            return dict(self._metadata)
        return read_metadata(self.metadata_path)

    def snapshot(self, path: Path | None = None) -> ExperimentFolder:
        """The folder with its metadata frozen: cells that are added later do not appear.

        Args:
            path: Another folder for the same metadata; this one by default.
        """
        return ExperimentFolder(path or self.path, self.read_metadata())

    def begin(
        self, manifest: Manifest, provenance: Mapping[str, Any], cells: Iterable[Identity]
    ) -> None:
        """Write the metadata of the experiment, with the provenance of this process.

        Raises:
            UserError: The folder has runs of cells that are not in the manifest.
        """
        before = self.read_metadata()
        cells = tuple(cells)
        if before:
            self._require_kept(cells_of(before), cells)
        write_metadata(
            self.metadata_path,
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
        """Refuse to drop cells that were run: the report would be a selection of results."""
        names = {identity.name for identity in cells}
        recorded = recorded_states(self.runs_path)
        lost = [
            identity.name
            for identity in before
            if identity.name not in names
            and (
                self.has_begun(identity.name) or recorded.get(identity.name, NOT_BEGUN) != NOT_BEGUN
            )
        ]
        if lost:
            more = f" and {len(lost) - 3} more" if len(lost) > 3 else ""
            raise UserError(
                f"{self.path} has runs of cells that are no longer in the manifest: "
                f"{', '.join(lost[:3])}{more}; put them back into it, or choose another --out"
            )

    def has_begun(self, name: str) -> bool:
        """Whether the run of a cell has started."""
        config = self.run(name).config_path
        return config.exists() and config.stat().st_size > 0

    def add_cells(self, cells: Iterable[Identity]) -> None:
        """Add cells to the metadata."""
        metadata = self.read_metadata()
        rows = [identity.as_row() for identity in cells]
        new = [row for row in rows if row not in metadata["cells"]]
        write_metadata(self.metadata_path, metadata | {"cells": [*metadata["cells"], *new]})

    def identities(self) -> tuple[Identity, ...]:
        """The cells of the experiment.

        Raises:
            UserError: The metadata are damaged or missing.
        """
        metadata = self.read_metadata()
        if not metadata:
            raise UserError(f"there is no experiment in {self.path}: it has no experiment.json")
        return cells_of(metadata)


def recorded_states(path: Path) -> dict[str, str]:
    """State of each cell in a table of runs, empty without a table; needs no pandas."""
    if not path.exists():
        return {}
    text = read_file(path, "table of an experiment").decode(errors="replace")
    rows = csv.DictReader(io.StringIO(text, newline=""))
    return {str(row.get("cell")): str(row.get("state")) for row in rows}
