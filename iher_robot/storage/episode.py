"""Real episode in storage: header, ticks, and file format."""

from __future__ import annotations

import dataclasses
import io
import json
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iher_robot.errors import UserError
from iher_robot.learning.episode import Episode
from iher_robot.storage.accounts import ACCOUNTS, Account
from iher_robot.storage.files.checksum import add_zip_checksum, check_zip

DONE = "done"
"""Ending of an episode that ran to its last tick."""

_FILE_NAMES = {"policy_source": "told_source"}
"""Names in files that differ from the attributes."""

# Errors of numpy and zipfile for a foreign archive.
UNREADABLE = (
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
class EpisodeHeader:
    """Description of an episode that is known before its first tick.

    Attributes:
        epoch: Epoch of the episode.
        policy_source: Source index that the policy received as input.
        account: Account that the ticks are charged to.
        seed: Seed of start, goal and noise.
        entry: Number of the reservation in the run's ledger.
    """

    epoch: int
    policy_source: int
    account: Account
    seed: int
    entry: int

    def to_json(self) -> str:
        """Encode the header for ``from_json``."""
        names = [field.name for field in dataclasses.fields(EpisodeHeader)]
        return json.dumps({_FILE_NAMES.get(name, name): getattr(self, name) for name in names})

    @staticmethod
    def from_json(text: str) -> EpisodeHeader:
        """Decode a header from ``to_json``.

        Raises:
            ValueError: The text is no header.
        """
        try:
            values = json.loads(text)
            for attribute, name in _FILE_NAMES.items():
                values[attribute] = values.pop(name)
            header = EpisodeHeader(**values)
        except (AttributeError, KeyError, TypeError) as error:
            raise ValueError(str(error)) from error
        if header.account not in ACCOUNTS:
            raise ValueError(f"account {header.account!r} does not exist")
        return header


@dataclass(frozen=True, eq=False)
class RecordedTick:
    """One control tick.

    Attributes:
        observation: Observation at the end of the tick. ``(obs_dim,)``
        action: Applied action, in [-1, 1]. ``(action_dim,)``
        requested_action: Requested action. ``(action_dim,)``
        valid: Whether it may be learned from.
        seq: The robot's tick counter at the end of the tick.
        elapsed: Ticks charged, including missed ticks before it.
    """

    observation: NDArray[np.floating]
    action: NDArray[np.floating]
    requested_action: NDArray[np.floating]
    valid: bool
    seq: int
    elapsed: int

    def as_record(self, kind: np.dtype[np.void] | None = None) -> NDArray[np.void]:
        """Encode the tick as one record, for ``from_record``.

        Args:
            kind: Type of an earlier record of the episode, which saves time.
        """
        values = tuple(np.asarray(getattr(self, name)) for name in _FIELDS)
        if kind is None:
            pairs = zip(_FIELDS, values, strict=True)
            kind = np.dtype([(name, value.dtype, value.shape) for name, value in pairs])
        return np.array(values, dtype=kind)

    @staticmethod
    def from_record(record: NDArray[np.void]) -> RecordedTick:
        """Decode a record from ``as_record``.

        Raises:
            ValueError: The record has other fields.
        """
        return RecordedTick(
            observation=record["observation"],
            action=record["action"],
            requested_action=record["requested_action"],
            valid=bool(record["valid"]),
            seq=int(record["seq"]),
            elapsed=int(record["elapsed"]),
        )


_FIELDS = tuple(field.name for field in dataclasses.fields(RecordedTick))


@dataclass(frozen=True)
class StoredEpisode(EpisodeHeader):
    """A real episode.

    Attributes:
        index: Index in the store, from 0.
        ended: ``"done"``, or why it ended early.
        seqs: The robot's tick counter at the end of each tick. ``(length,)``
        elapsed: Ticks charged for each tick, usually 1. ``(length,)``
        episode: The data, in their original precision.
    """

    index: int
    ended: str
    seqs: NDArray[np.int64]
    elapsed: NDArray[np.int64]
    episode: Episode

    @property
    def header(self) -> EpisodeHeader:
        """The header alone."""
        return EpisodeHeader(self.epoch, self.policy_source, self.account, self.seed, self.entry)

    def ticks(self) -> list[RecordedTick]:
        """The ticks, as they were recorded."""
        episode = self.episode
        return [
            RecordedTick(
                observation=episode.observations[tick + 1],
                action=episode.actions[tick],
                requested_action=episode.requested_actions[tick],
                valid=bool(episode.valid[tick]),
                seq=int(self.seqs[tick]),
                elapsed=int(self.elapsed[tick]),
            )
            for tick in range(len(episode))
        ]

    def pack(self) -> bytes:
        """Encode the episode for ``read_episode``: a NumPy archive with a checksum."""
        buffer = io.BytesIO()
        np.savez(
            buffer,
            allow_pickle=False,
            index=np.int64(self.index),
            header=np.str_(self.header.to_json()),
            ended=np.str_(self.ended),
            seqs=self.seqs,
            elapsed=self.elapsed,
            **{name: getattr(self.episode, name) for name in _ARRAYS},
        )
        return add_zip_checksum(buffer.getvalue())


def make_episode(
    start: NDArray[np.floating], desired_goal: NDArray[np.floating], ticks: Sequence[RecordedTick]
) -> Episode:
    """Assemble an episode from recorded ticks.

    Args:
        start: Observation before the first tick. ``(obs_dim,)``
        desired_goal: The goal. ``(goal_dim,)``
        ticks: At least one.
    """
    return Episode(
        observations=np.stack([start, *(tick.observation for tick in ticks)]),
        actions=np.stack([tick.action for tick in ticks]),
        requested_actions=np.stack([tick.requested_action for tick in ticks]),
        valid=np.array([tick.valid for tick in ticks]),
        desired_goal=desired_goal,
    )


def read_episode(path: Path, archive: bytes, index: int) -> StoredEpisode:
    """Decode an episode and check its checksum.

    Args:
        path: The file, for messages.
        archive: Content of the file.
        index: Expected index in the store.

    Raises:
        UserError: The file is damaged, or holds another episode.
    """
    check_zip(archive, path, "episode file")
    try:
        with np.load(io.BytesIO(archive), allow_pickle=False) as file:
            stored = StoredEpisode(
                **dataclasses.asdict(EpisodeHeader.from_json(str(file["header"]))),
                index=int(file["index"]),
                ended=str(file["ended"]),
                seqs=file["seqs"],
                elapsed=file["elapsed"],
                episode=Episode(**{name: file[name] for name in _ARRAYS}),
            )
    except UNREADABLE as error:
        raise UserError(f"{path} is no episode file of iher-robot: {error}") from error
    if stored.index != index:
        raise UserError(f"{path} holds episode {stored.index}; restore the files' names")
    return stored


def pack_array(array: NDArray[Any]) -> bytes:
    """Encode an array in NumPy's file format."""
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def unpack_array(content: bytes) -> NDArray[Any]:
    """Decode an array in NumPy's file format.

    Raises:
        ValueError: It is no such array, or holds Python objects.
    """
    array: NDArray[Any] = np.load(io.BytesIO(content), allow_pickle=False)
    return array
