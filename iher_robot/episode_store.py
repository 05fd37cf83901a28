"""Real episodes on disk: each durable when it ends, each readable on its own by numpy."""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from iher_robot.durable_file import (
    TEMPORARY_SUFFIX,
    check_seal,
    read_file,
    seal_zip,
    write_atomically,
)
from iher_robot.errors import UserError
from iher_robot.learning.episode import Episode
from iher_robot.ledger import ACCOUNTS, Account

_NAME = re.compile(r"episode-(\d{6,})\.npz")
# What numpy and zipfile raise on a foreign archive.
_UNREADABLE = (
    AttributeError,
    EOFError,
    LookupError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    zipfile.BadZipFile,
    zlib.error,
)
_ARRAYS = ("observations", "actions", "requested_actions", "valid", "desired_goal")


@dataclass(frozen=True)
class StoredEpisode:
    """A real episode and how it came about.

    Attributes:
        index: Place in the store, from 0.
        epoch: Epoch in which it was collected.
        told_source: Source that the policy was told.
        account: Account that its ticks were charged to.
        episode: The data, in the precision in which they were given.
    """

    index: int
    epoch: int
    told_source: int
    account: Account
    episode: Episode


class EpisodeStore:
    """Append-only folder of ``episode-000000.npz``, ``episode-000001.npz``, and so on.

    Args:
        directory: The folder; created if it does not exist.

    Raises:
        UserError: An episode is missing in the middle, or the folder cannot be used.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        try:
            directory.mkdir(exist_ok=True)
            for leftover in directory.glob(f".*{TEMPORARY_SUFFIX}"):
                leftover.unlink()
            names = {path.name for path in directory.iterdir() if _NAME.fullmatch(path.name)}
        except OSError as error:
            raise UserError(f"cannot use episode folder {directory}: {error.strerror}") from error
        self._length = len(names)
        for index in range(self._length):
            if self._path(index).name not in names:
                raise UserError(
                    f"{self._path(index)} is missing, though later episodes are there; put it back"
                )

    def __len__(self) -> int:
        """Number of stored episodes."""
        return self._length

    def __iter__(self) -> Iterator[StoredEpisode]:
        """Load all episodes, oldest first."""
        return (self.load(index) for index in range(self._length))

    def append(
        self, episode: Episode, *, epoch: int, told_source: int, account: Account = "motion"
    ) -> int:
        """Store an episode; when this returns, it survives a crash.

        Args:
            episode: The data.
            epoch: Epoch in which it was collected.
            told_source: Source that the policy was told.
            account: Account that its ticks were charged to.

        Returns:
            Its index.

        Raises:
            UserError: The system refuses, such as on a full disk; the store is as before.
        """
        index = self._length
        buffer = io.BytesIO()
        np.savez(
            buffer,
            allow_pickle=False,
            index=np.int64(index),
            epoch=np.int64(epoch),
            told_source=np.int64(told_source),
            account=np.str_(account),
            **{name: getattr(episode, name) for name in _ARRAYS},
        )
        sealed = seal_zip(buffer.getvalue())
        write_atomically(self._path(index), lambda file: file.write(sealed))
        self._length += 1
        return index

    def load(self, index: int) -> StoredEpisode:
        """Read an episode and check that every byte is as it was written.

        Args:
            index: Place in the store.

        Raises:
            IndexError: There is no such episode.
            UserError: The file is missing, truncated, damaged, or another episode's.
        """
        if not 0 <= index < self._length:
            raise IndexError(f"episode {index} of {self._length}")
        path = self._path(index)
        sealed = read_file(path, "episode file")
        check_seal(sealed, path, "episode file")
        try:
            with np.load(io.BytesIO(sealed), allow_pickle=False) as file:
                stored = StoredEpisode(
                    index=int(file["index"]),
                    epoch=int(file["epoch"]),
                    told_source=int(file["told_source"]),
                    account=str(file["account"]),  # type: ignore[arg-type]
                    episode=Episode(**{name: file[name] for name in _ARRAYS}),
                )
        except _UNREADABLE as error:
            raise UserError(f"{path} is no episode file of iher-robot: {error}") from error
        if stored.account not in ACCOUNTS:
            raise UserError(f"{path} names account {stored.account!r}, which does not exist")
        if stored.index != index:
            raise UserError(f"{path} holds episode {stored.index}; restore the files' names")
        return stored

    def _path(self, index: int) -> Path:
        return self.directory / f"episode-{index:06d}.npz"
