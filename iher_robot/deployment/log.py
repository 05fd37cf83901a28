"""The folder of a deployment: what it was, and every control tick of it."""

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
    """What became of an episode.

    Attributes:
        episode: Number, from 1.
        seed: Decided start and goal.
        ticks: Control ticks charged; the one in flight counts, since the robot may have moved.
        success: Whether it succeeded: the operator's judgement, else the task's.
        task_success: Whether the last step met the goal; never so in an episode that ended early.
        operator_success: What the operator said, None if nothing.
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
    """Writes ``deployment.json`` and ``ticks.jsonl``; make one by ``create``.

    A tick's line is with the system before the next tick begins, so that it survives a crash of
    this program; it is on the disk when its episode has ended.

    Args:
        path: The folder, which exists.
        header: What the deployment is, plain values.
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
        """Make the folder.

        Args:
            path: A folder that does not exist yet, or is empty.
            header: What the deployment is, plain values.

        Raises:
            UserError: The folder holds something, is a file, or cannot be written.
        """
        try:
            path.mkdir(parents=True, exist_ok=True)
            if any(path.iterdir()):
                raise UserError(f"deployment folder {path} is not empty; choose another with --out")
            return cls(path, header)
        except OSError as error:
            raise UserError(
                f"cannot make deployment folder {path}: {error.strerror or error}; choose another "
                "with --out"
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
            seed: Decides start and goal.
        """
        record = EpisodeRecord(len(self.episodes) + 1, seed)
        self.episodes.append(record)
        return record

    def tick(self, values: Mapping[str, Any]) -> None:
        """Add the line of a tick; numbers that are not finite become null.

        Args:
            values: Scalars, text, and arrays.

        Raises:
            UserError: The system refuses, such as on a full disk.
        """
        line = json.dumps({name: _plain(value) for name, value in values.items()}, allow_nan=False)
        try:
            self._file.write(line.encode() + b"\n")
            self._file.flush()
        except OSError as error:
            raise self._cannot_write(error) from error
        self.lines += 1

    def sync(self) -> None:
        """Put everything so far on the disk.

        Raises:
            UserError: The system refuses.
        """
        try:
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise self._cannot_write(error) from error
        self._write_document()

    def summary(self) -> str:
        """What is in the log, in a few words."""
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
    """Name of a folder if none is given, such as ``deployments/20250131T120000Z-push``.

    Args:
        task: Name of the task.
        now: When it starts, by default at this moment.
    """
    moment = (now or datetime.now(UTC)).astimezone(UTC)
    return Path("deployments") / f"{moment:%Y%m%dT%H%M%SZ}-{task}"


def file_digest(path: Path, kind: str) -> str:
    """SHA-256 of a file, in hexadecimal digits.

    Args:
        path: The file.
        kind: What it is, for the message.

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
