"""Log of a deployment: its settings and results, and a line for every control tick."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from iher_robot.errors import UserError, describe
from iher_robot.storage.episode import DONE
from iher_robot.storage.files.atomic import read_file, sync_directory, write_atomically

RUNNING = "running"


@dataclass
class EpisodeRecord:
    """Record of an episode.

    Attributes:
        episode: Number, from 1.
        seed: Seed of start and goal.
        ticks: Control ticks charged, including an unfinished one: the robot may have moved.
        success: Whether it succeeded: the operator's label, else the task's result.
        task_success: Whether the last step met the goal; False in an episode that ended early.
        operator_success: The operator's label, None without one.
        ended: ``"done"``, or why it ended early.
    """

    episode: int
    seed: int
    ticks: int = 0
    success: bool = False
    task_success: bool = False
    operator_success: bool | None = None
    ended: str = RUNNING

    @property
    def aborted(self) -> bool:
        """Whether it ended early."""
        return self.ended != DONE


class DeploymentLog:
    """Writes ``deployment.json`` and ``ticks.jsonl``; created by ``create``.

    The line of a tick is flushed before the next tick begins, so that it survives a crash of this
    process; it is synced to disk when its episode ends.

    Args:
        path: An existing folder.
        header: Metadata of the deployment, plain values.
    """

    def __init__(self, path: Path, header: Mapping[str, Any]) -> None:
        self.path = path
        self.document_path = path / "deployment.json"
        self.ticks_path = path / "ticks.jsonl"
        self.episodes: list[EpisodeRecord] = []
        self.lines = 0
        self._header = dict(header)
        self._ended = RUNNING
        self._write_document()
        self._file = self.ticks_path.open("xb")
        sync_directory(path)

    @classmethod
    def create(cls, path: Path, header: Mapping[str, Any]) -> DeploymentLog:
        """Create the folder.

        Args:
            path: A folder that does not exist yet, or is empty.
            header: Metadata of the deployment, plain values.

        Raises:
            UserError: The folder is not empty, is a file, or cannot be written.
        """
        try:
            path.mkdir(parents=True, exist_ok=True)
            if any(path.iterdir()):
                raise UserError(f"deployment folder {path} is not empty; choose another with --out")
            return cls(path, header)
        except OSError as error:
            raise UserError(
                f"cannot create deployment folder {path}: {error.strerror or error}; choose "
                "another with --out"
            ) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._ended = DONE if error is None else describe(error)
        try:
            self.sync()
        finally:
            self._file.close()

    def begin_episode(self, seed: int) -> EpisodeRecord:
        """Start the record of an episode.

        Args:
            seed: Seed of start and goal.
        """
        record = EpisodeRecord(len(self.episodes) + 1, seed)
        self.episodes.append(record)
        return record

    def tick(self, values: Mapping[str, Any]) -> None:
        """Add the line of a tick; non-finite numbers become null.

        Args:
            values: Scalars, text, and arrays.

        Raises:
            UserError: The line cannot be written, such as on a full disk.
        """
        line = json.dumps({name: _plain(value) for name, value in values.items()}, allow_nan=False)
        try:
            self._file.write(line.encode() + b"\n")
            self._file.flush()
        except OSError as error:
            raise self._cannot_write(error) from error
        self.lines += 1

    def sync(self) -> None:
        """Sync everything so far to disk.

        Raises:
            UserError: The file cannot be written.
        """
        try:
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise self._cannot_write(error) from error
        self._write_document()

    def summary(self) -> str:
        """Short summary of the log."""
        count, ticks = len(self.episodes), "tick" if self.lines == 1 else "ticks"
        successes = sum(record.success for record in self.episodes)
        return f"{successes} of {count} episodes succeeded, {self.lines} {ticks} in {self.path}"

    def _write_document(self) -> None:
        results = {
            "ended": self._ended,
            "episodes": [dataclasses.asdict(record) for record in self.episodes],
        }
        text = json.dumps(_plain(self._header | results), indent=2, allow_nan=False) + "\n"
        write_atomically(self.document_path, lambda file: file.write(text.encode()))

    def _cannot_write(self, error: OSError) -> UserError:
        return UserError(f"cannot write {self.ticks_path}: {error.strerror or error}")


def default_deployment_path(task: str, now: datetime | None = None) -> Path:
    """Default folder, such as ``deployments/20250131T120000Z-push``.

    Args:
        task: Name of the task.
        now: Time of the start; the current time by default.
    """
    moment = (now or datetime.now(UTC)).astimezone(UTC)
    return Path("deployments") / f"{moment:%Y%m%dT%H%M%SZ}-{task}"


def file_digest(path: Path, kind: str) -> str:
    """SHA-256 of a file, in hexadecimal digits.

    Args:
        path: The file.
        kind: Kind of file, for the message.

    Raises:
        UserError: It cannot be read.
    """
    return hashlib.sha256(read_file(path, kind)).hexdigest()


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(name): _plain(part) for name, part in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value
