"""Reader of an episode folder."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from pathlib import Path

from drivers.closing import Closing
from iher_robot.errors import UserError
from iher_robot.storage.episode import StoredEpisode, read_episode
from iher_robot.storage.episode_journal import EpisodeIndex, RunningEpisode
from iher_robot.storage.files.atomic import read_file

INDEX_NAME = "index.sqlite"

_NAME = re.compile(r"episode-(\d{6,})\.npz")


class EpisodeReader(Closing):
    """A folder of ``episode-000000.npz``, ``episode-000001.npz``, and so on, with its index.

    Shows the folder as it was when it was opened, even while a run writes it.

    Args:
        directory: The folder.

    Raises:
        UserError: There is no such folder, an episode is missing, or the index is damaged.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._index = self._open_index()
        try:
            self._check_names()
        except BaseException:
            self.close()
            raise

    def __len__(self) -> int:
        """Number of stored episodes."""
        return len(self._index.digests)

    def __iter__(self) -> Iterator[StoredEpisode]:
        """Load all episodes, oldest first."""
        return (self.load(index) for index in range(len(self)))

    @property
    def running(self) -> RunningEpisode | None:
        """The episode that was being recorded when the folder was opened, or None."""
        return self._index.running

    def path(self, index: int) -> Path:
        """The file of an episode."""
        return self.directory / f"episode-{index:06d}.npz"

    def load(self, index: int) -> StoredEpisode:
        """Read an episode and check its checksum.

        Args:
            index: Index in the store.

        Raises:
            IndexError: There is no such episode.
            UserError: The file is missing, damaged, or holds another episode.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"episode {index} of {len(self)}")
        path = self.path(index)
        archive = read_file(path, "episode file")
        stored = read_episode(path, archive, index)
        if file_digest(archive) != self._index.digests[index]:
            raise UserError(f"{path} is not the file that was stored; restore that one")
        return stored

    def close(self) -> None:
        """Release the folder; closing twice does nothing."""
        self._index.close()

    def _open_index(self) -> EpisodeIndex:
        if not self.directory.is_dir():
            raise UserError(f"there is no episode folder at {self.directory}")
        return EpisodeIndex(self.directory / INDEX_NAME, read_only=True)

    def _check_names(self) -> None:
        names = self._file_names()
        for index in range(len(self)):
            if self.path(index).name not in names:
                raise UserError(f"{self.path(index)} is missing; restore it")

    def _file_names(self) -> set[str]:
        return {path.name for path in self.directory.iterdir() if _NAME.fullmatch(path.name)}


def file_digest(archive: bytes) -> str:
    """SHA-256 of an episode's file, as the index holds it."""
    return hashlib.sha256(archive).hexdigest()
