"""Real episodes on disk: each tick in a journal, each episode durable when it ends."""

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
from iher_robot.storage.episode_journal import EpisodeIndex, Running
from iher_robot.storage.episode_reader import INDEX_NAME, EpisodeReader, file_digest
from iher_robot.storage.files.atomic import TEMPORARY_SUFFIX, read_file, write_atomically
from iher_robot.storage.files.lock import LockFile

CUT_OFF = "cut off: the program ended in it"

_LOCK = "store.lock"


class EpisodeStore(EpisodeReader):
    """The same folder for its one writer, append-only.

    Between ``begin`` and ``seal`` every tick goes into a journal. What a crash leaves there is
    sealed when the store is opened again.

    Args:
        directory: The folder; created if it does not exist.
        durable_ticks: Whether ``record`` waits for the disk, so that a tick survives a crash of
            the machine, too; without it only a crash of the program.

    Attributes:
        recovered: Place of the episode that a crash had cut off, None if there was none.

    Raises:
        FileHeld: Another process writes it.
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
        """Begin an episode; when this returns, it is in the journal.

        Args:
            header: How it comes about.
            observation: Before the first tick. ``(obs_dim,)``
            desired_goal: ``(goal_dim,)``

        Raises:
            UserError: The system refuses, such as on a full disk.
        """
        running = Running(len(self), header, observation, desired_goal, [])
        self._index.begin(running, durable=self.durable_ticks)
        self._note()

    def record(self, tick: RecordedTick) -> None:
        """Add a tick to the episode; when this returns, it is in the journal.

        Raises:
            UserError: The system refuses, such as on a full disk; the ticks before are kept.
        """
        self._index.record(tick)
        self._note()

    def keep(self, stored: StoredEpisode, index: int) -> None:
        """Store a whole episode that came about elsewhere; when this returns, it is durable.

        It is in the journal as a whole before it is sealed, so that a crash leaves it there. After
        an interrupt the same may be asked again: what is left to do is done.

        Args:
            stored: It, whatever its index was elsewhere.
            index: Its own: that of the next one, when this was first asked.

        Raises:
            UserError: The system refuses, such as on a full disk.
        """
        self._index.catch_up()
        if index < len(self):
            self._note()
            return
        assert index == len(self), "one after the other"
        episode = stored.episode
        running = Running(
            index, stored.header, episode.observations[0], episode.desired_goal, stored.ticks()
        )
        self._index.begin(running, durable=False)
        self._note()
        self.seal(stored.ended)

    def seal(self, ended: str) -> int | None:
        """End the episode; when this returns, it is durable.

        Args:
            ended: ``"done"``, or what cut it short.

        Returns:
            Its index, or None if none was begun or not a tick of it was recorded: then there is
            nothing to keep.

        Raises:
            UserError: The system refuses, such as on a full disk; the journal still has it.
        """
        running = self.running
        if running is None or not running.ticks:
            self._index.forget_running()
            return None
        return self.append(running.stored(ended))

    def append(self, stored: StoredEpisode) -> int:
        """Store an episode as the next one; when this returns, it is durable.

        Args:
            stored: It, whatever its index was elsewhere.

        Returns:
            Its index.

        Raises:
            UserError: The system refuses, such as on a full disk; the store is as before.
        """
        index = len(self)
        archive = dataclasses.replace(stored, index=index).pack()
        write_atomically(self.path(index), lambda file: file.write(archive))
        self._index.add(file_digest(archive))
        self._note()
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
        self._require_newest()
        self._check_newer_names()
        running, beyond = self.running, self.path(len(self))
        if not beyond.exists():
            return self.seal(CUT_OFF)
        # It was sealed, and only not indexed; its last tick may have had no room in the journal.
        unknown = UserError(
            f"{self.directory / INDEX_NAME} does not know {beyond.name}; put the newest index back"
        )
        if running is None and self._lock.note:
            raise unknown
        archive = read_file(beyond, "episode file")
        stored = read_episode(beyond, archive, len(self))
        known = running is None  # as a crash of the machine may leave it, and nothing else
        if running is not None:
            known = stored.header == running.header and len(stored.episode) >= len(running.ticks)
        if not known:
            raise unknown
        self._index.add(file_digest(archive))
        self._note()
        return stored.index

    def _check_newer_names(self) -> None:
        names = self._file_names()
        # One more may have been sealed just before a crash.
        if names - {self.path(index).name for index in range(len(self) + 1)}:
            raise UserError(
                f"{self.directory / INDEX_NAME} knows {len(self)} episodes, but there are files of "
                f"{len(names)}; put the newest index back"
            )

    def _require_newest(self) -> None:
        """Check that the index still has all that its last writer had noted."""
        episodes, ticks = self._lock.note.get("at", (0, 0))
        found = 0 if self.running is None else len(self.running.ticks)
        if (len(self), found) < (episodes, ticks):
            raise UserError(
                f"{self.directory / INDEX_NAME} lost a part: it had {episodes} episodes and "
                f"{ticks} ticks of another, and has {len(self)} and {found}; it or its -wal file "
                "is damaged or too old, put the newest ones back"
            )

    def _note(self) -> None:
        self._lock.write(at=(len(self), 0 if self.running is None else len(self.running.ticks)))
