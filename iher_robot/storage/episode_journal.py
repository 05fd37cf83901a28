"""Index of an episode folder and journal of the running episode, in one SQLite file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.closing import Closing
from iher_robot.errors import UserError
from iher_robot.storage.episode import (
    UNREADABLE,
    EpisodeHeader,
    RecordedTick,
    StoredEpisode,
    make_episode,
    pack_array,
    unpack_array,
)
from iher_robot.storage.files.sqlite import Database, Format, row_checksum

INDEX = Format(
    kind="episode index",
    application_id=0x69686570,  # "ihep" in ASCII
    version=1,
    schema=(
        """CREATE TABLE episode (
            id INTEGER PRIMARY KEY,
            sha256 TEXT NOT NULL,
            seal BLOB NOT NULL
        )""",
        """CREATE TABLE running (
            id INTEGER PRIMARY KEY,
            header TEXT NOT NULL,
            observation BLOB NOT NULL,
            desired_goal BLOB NOT NULL,
            seal BLOB NOT NULL
        )""",
        """CREATE TABLE tick (
            id INTEGER PRIMARY KEY,
            record BLOB NOT NULL,
            seal BLOB NOT NULL
        )""",
    ),
)


@dataclass(frozen=True, eq=False)
class RunningEpisode:
    """The episode that is being recorded.

    Attributes:
        index: Index that it will have in the store.
        header: Its description.
        observation: Observation before the first tick. ``(obs_dim,)``
        desired_goal: The goal. ``(goal_dim,)``
        ticks: Ticks recorded so far.
    """

    index: int
    header: EpisodeHeader
    observation: NDArray[np.floating]
    desired_goal: NDArray[np.floating]
    ticks: list[RecordedTick]

    def stored(self, ended: str) -> StoredEpisode:
        """The episode to be stored.

        Args:
            ended: ``"done"``, or why it ended early.
        """
        return StoredEpisode(
            **vars(self.header),
            index=self.index,
            ended=ended,
            seqs=np.array([tick.seq for tick in self.ticks], dtype=np.int64),
            elapsed=np.array([tick.elapsed for tick in self.ticks], dtype=np.int64),
            episode=make_episode(self.observation, self.desired_goal, self.ticks),
        )


class EpisodeIndex(Closing):
    """Digests of the stored episodes' files, and the journal of the running episode.

    Args:
        path: The file; created if it does not exist, unless ``read_only``.
        read_only: Change nothing; another process may be writing.

    Raises:
        UserError: The file is no index, is damaged, or cannot be used.
    """

    def __init__(self, path: Path, *, read_only: bool = False) -> None:
        self.path = path
        self._database = Database(path, INDEX, read_only=read_only)
        self._kind: np.dtype[np.void] | None = None
        try:
            with self._database.snapshot():
                self.digests = self._read_digests()
                self.running = self._read_running()
        except BaseException:
            self.close()
            raise
        if not read_only:  # checkpoints wait until an episode ends: none may delay a tick
            self._database.execute("PRAGMA wal_autocheckpoint = 0")

    def begin(self, running: RunningEpisode, *, durable: bool) -> None:
        """Start the journal of an episode.

        Args:
            running: The episode, with any ticks that it already has.
            durable: Whether this and every tick waits for the disk.

        Raises:
            UserError: The system refuses.
        """
        arrays = (pack_array(running.observation), pack_array(running.desired_goal))
        row = (running.index, running.header.to_json(), *arrays)
        self._database.durable(durable)
        with self._database.transaction():
            self._clear()
            self._database.execute(
                "INSERT INTO running VALUES (?, ?, ?, ?, ?)", (*row, row_checksum(*row))
            )
            for number, tick in enumerate(running.ticks):
                self._insert(number, tick)
        self.running = running

    def record(self, tick: RecordedTick) -> None:
        """Add a tick to the journal.

        Raises:
            UserError: The system refuses.
        """
        assert self.running is not None, "begin comes first"
        # First: a tick that cannot be journalled may still be stored.
        self.running.ticks.append(tick)
        self._insert(len(self.running.ticks) - 1, tick)

    def add(self, digest: str) -> None:
        """Add the next episode to the index, durably, and clear the journal.

        Args:
            digest: SHA-256 of the episode's file, hexadecimal.

        Raises:
            UserError: The system refuses.
        """
        row = (len(self.digests), digest)
        self._database.durable(True)
        with self._database.transaction():
            self._database.execute(
                "INSERT INTO episode VALUES (?, ?, ?)", (*row, row_checksum(*row))
            )
            self._clear()
        self._append([digest])
        self._database.rows("PRAGMA wal_checkpoint(TRUNCATE)")

    def catch_up(self) -> None:
        """Read entries of the file that an interrupt kept from this object."""
        query = "SELECT sha256 FROM episode WHERE id >= ? ORDER BY id"
        rows = self._database.rows(query, (len(self.digests),))
        if rows:
            self._append([digest for (digest,) in rows])

    def discard_running(self) -> None:
        """Discard the running episode, of which no tick is recorded."""
        assert self.running is None or not self.running.ticks
        with self._database.transaction():
            self._clear()
        self.running = None

    def close(self) -> None:
        """Release the file; closing twice does nothing."""
        self._database.close()

    def _append(self, digests: list[str]) -> None:
        self.running = None  # first: `catch_up` repairs what an interrupt leaves
        self.digests += digests

    def _insert(self, number: int, tick: RecordedTick) -> None:
        # The first record carries the type of all, as a file of NumPy's does.
        record = tick.as_record(self._kind if number else None)
        self._kind = record.dtype
        row = (number, record.tobytes() if number else pack_array(record))
        self._database.execute("INSERT INTO tick VALUES (?, ?, ?)", (*row, row_checksum(*row)))

    def _clear(self) -> None:
        self._database.execute("DELETE FROM running")
        self._database.execute("DELETE FROM tick")

    def _read_digests(self) -> list[str]:
        rows = self._database.rows("SELECT * FROM episode ORDER BY id")
        self._check_rows(rows)
        return [digest for _, digest, _ in rows]

    def _read_running(self) -> RunningEpisode | None:
        rows = self._database.rows("SELECT * FROM running ORDER BY id")
        records = self._database.rows("SELECT * FROM tick ORDER BY id")
        self._check_rows(records)
        if not rows:
            return None
        index, header, observation, desired_goal, checksum = rows[0]
        if len(rows) > 1 or index != len(self.digests) or checksum != row_checksum(*rows[0][:-1]):
            raise self._damaged()
        try:
            return RunningEpisode(
                index=index,
                header=EpisodeHeader.from_json(header),
                observation=unpack_array(observation),
                desired_goal=unpack_array(desired_goal),
                ticks=_read_ticks([record for _, record, _ in records]),
            )
        except UNREADABLE as error:
            raise self._damaged() from error

    def _check_rows(self, rows: Sequence[tuple[object, ...]]) -> None:
        for number, row in enumerate(rows):
            if row[0] != number or row[-1] != row_checksum(*row[:-1]):
                raise self._damaged()

    def _damaged(self) -> UserError:
        return UserError(
            f"{self.path} is damaged; restore the index that belongs to the episode files"
        )


def _read_ticks(records: Sequence[bytes]) -> list[RecordedTick]:
    if not records:
        return []
    first = unpack_array(records[0])
    rest = [np.frombuffer(record, first.dtype).reshape(()) for record in records[1:]]
    return [RecordedTick.from_record(record) for record in (first, *rest)]
