"""Append-only store of real episodes: ticks go to a journal, whole episodes to files."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from iher_robot.errors import UserError
from iher_robot.storage.episode import (
    EpisodeHeader,
    RecordedTick,
    StoredEpisode,
    read_episode,
)
from iher_robot.storage.episode_journal import EpisodeIndex, RunningEpisode
from iher_robot.storage.episode_reader import INDEX_NAME, EpisodeReader, file_digest
from iher_robot.storage.files.atomic import TEMPORARY_SUFFIX, read_file, write_atomically
from iher_robot.storage.files.lock import LockFile

CUT_OFF = "cut off: the program ended in it"

_LOCK = "store.lock"


class EpisodeStore(EpisodeReader):
    """Writer of an episode folder, one process at a time.

    Ticks between ``begin`` and ``seal`` go to a journal. An episode that a crash left there is
    sealed when the store is opened again.

    Args:
        directory: The folder; created if it does not exist.
        durable_ticks: Whether ``record`` waits for the disk, so that a tick also survives a crash
            of the machine, not only of the process.

    Attributes:
        recovered: Index of the episode that a crash had cut off, or None.

    Raises:
        FileHeld: Another process writes the folder.
        UserError: An episode is missing, the index is damaged, or the folder cannot be used.
    """

    def __init__(self, directory: Path, *, durable_ticks: bool = False) -> None:
        self.durable_ticks = durable_ticks
        try:
            directory.mkdir(exist_ok=True)
        except OSError as error:
            raise UserError(f"cannot use episode folder {directory}: {error.strerror}") from error
        self._lock = LockFile(
            directory / _LOCK, f"episode folder {directory} is in use by another run"
        )
        try:
            super().__init__(directory)
            self.recovered = self._recover()
        except BaseException:
            self._lock.close()
            raise

    def begin(
        self,
        header: EpisodeHeader,
        observation: NDArray[np.floating],
        desired_goal: NDArray[np.floating],
    ) -> None:
        """Begin an episode in the journal.

        Args:
            header: Its description.
            observation: Observation before the first tick. ``(obs_dim,)``
            desired_goal: The goal. ``(goal_dim,)``

        Raises:
            UserError: The system refuses, such as on a full disk.
        """
        running = RunningEpisode(len(self), header, observation, desired_goal, [])
        self._index.begin(running, durable=self.durable_ticks)
        self._write_note()

    def record(self, tick: RecordedTick) -> None:
        """Add a tick to the journal of the episode.

        Raises:
            UserError: The system refuses, such as on a full disk; earlier ticks are kept.
        """
        self._index.record(tick)
        self._write_note()

    def keep(self, stored: StoredEpisode, index: int) -> None:
        """Store a whole episode of another process; when this returns, it is durable.

        The journal holds it until it is sealed, so that a crash does not lose it. The call is
        idempotent: after an interrupt it may be repeated.

        Args:
            stored: The episode; its own index is ignored.
            index: Index for it, which was the next one at the first call.

        Raises:
            UserError: The system refuses, such as on a full disk.
        """
        self._index.catch_up()
        if index < len(self):
            self._write_note()
            return
        assert index == len(self), "episodes are stored in order"
        episode = stored.episode
        running = RunningEpisode(
            index, stored.header, episode.observations[0], episode.desired_goal, stored.ticks()
        )
        self._index.begin(running, durable=False)
        self._write_note()
        self.seal(stored.ended)

    def seal(self, ended: str) -> int | None:
        """End the episode; when this returns, it is durable.

        Args:
            ended: ``"done"``, or why it ended early.

        Returns:
            Its index, or None if no episode was begun or it has no tick.

        Raises:
            UserError: The system refuses, such as on a full disk; the journal keeps it.
        """
        running = self.running
        if running is None or not running.ticks:
            self._index.discard_running()
            return None
        return self.append(running.stored(ended))

    def append(self, stored: StoredEpisode) -> int:
        """Store an episode as the next one; when this returns, it is durable.

        Args:
            stored: The episode; its own index is ignored.

        Returns:
            Its index.

        Raises:
            UserError: The system refuses, such as on a full disk; the store is unchanged.
        """
        index = len(self)
        archive = dataclasses.replace(stored, index=index).pack()
        write_atomically(self.path(index), lambda file: file.write(archive))
        self._index.add(file_digest(archive))
        self._write_note()
        return index

    def close(self) -> None:
        """Release the folder; closing twice does nothing."""
        super().close()
        self._lock.close()

    def _open_index(self) -> EpisodeIndex:
        for leftover in self.directory.glob(f".*{TEMPORARY_SUFFIX}"):
            leftover.unlink()
        return EpisodeIndex(self.directory / INDEX_NAME)

    def _recover(self) -> int | None:
        self._check_newest()
        self._check_newer_names()
        running, beyond = self.running, self.path(len(self))
        if not beyond.exists():
            return self.seal(CUT_OFF)
        # Its file was written, but not indexed. The journal may lack its last tick.
        not_indexed = UserError(
            f"{self.directory / INDEX_NAME} does not know {beyond.name}; restore the newest index"
        )
        if running is None and self._lock.note:
            raise not_indexed
        archive = read_file(beyond, "episode file")
        stored = read_episode(beyond, archive, len(self))
        known = running is None  # only a crash of the machine leaves it so
        if running is not None:
            known = stored.header == running.header and len(stored.episode) >= len(running.ticks)
        if not known:
            raise not_indexed
        self._index.add(file_digest(archive))
        self._write_note()
        return stored.index

    def _check_newer_names(self) -> None:
        names = self._file_names()
        # One more may have been sealed just before a crash.
        if names - {self.path(index).name for index in range(len(self) + 1)}:
            raise UserError(
                f"{self.directory / INDEX_NAME} knows {len(self)} episodes, but there are files of "
                f"{len(names)}; restore the newest index"
            )

    def _check_newest(self) -> None:
        """Check that the index still has everything that its last writer noted."""
        episodes, ticks = self._lock.note.get("at", (0, 0))
        found = 0 if self.running is None else len(self.running.ticks)
        if (len(self), found) < (episodes, ticks):
            raise UserError(
                f"{self.directory / INDEX_NAME} lost a part: it had {episodes} episodes and "
                f"{ticks} ticks of another, and has {len(self)} and {found}; it or its -wal file "
                "is damaged or too old; restore the newest ones"
            )

    def _write_note(self) -> None:
        self._lock.write(at=(len(self), 0 if self.running is None else len(self.running.ticks)))
