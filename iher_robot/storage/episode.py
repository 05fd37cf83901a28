"""A real episode as it is kept: its ticks, how it came about, and its file."""

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
"""How an episode ended that nothing cut short."""

_FILE_NAMES = {"policy_source": "told_source"}
"""Names in files, where they differ from the attributes."""

# What numpy and zipfile raise on a foreign archive.
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
    """What is known of an episode before its first tick.

    Attributes:
        epoch: Epoch that it belongs to.
        policy_source: Source that the policy was told.
        account: Account that its ticks are charged to.
        seed: Decided its start, its goal and the noise.
        entry: Number of the reservation in the run's ledger.
    """

    epoch: int
    policy_source: int
    account: Account
    seed: int
    entry: int

    def to_json(self) -> str:
        """Text for ``from_json``."""
        names = [field.name for field in dataclasses.fields(EpisodeHeader)]
        return json.dumps({_FILE_NAMES.get(name, name): getattr(self, name) for name in names})

    @staticmethod
    def from_json(text: str) -> EpisodeHeader:
        """Read what ``to_json`` wrote.

        Raises:
            ValueError: It is something else.
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
        observation: What it ended with. ``(obs_dim,)``
        action: The action as it was applied, in [-1, 1]. ``(action_dim,)``
        requested_action: The action as it was asked for. ``(action_dim,)``
        valid: Whether it may be learned from.
        seq: The robot's own tick counter at its end.
        elapsed: Ticks that are charged for it: those that passed unseen before it included.
    """

    observation: NDArray[np.floating]
    action: NDArray[np.floating]
    requested_action: NDArray[np.floating]
    valid: bool
    seq: int
    elapsed: int

    def as_record(self, kind: np.dtype[np.void] | None = None) -> NDArray[np.void]:
        """One record, for ``from_record``.

        Args:
            kind: That of an earlier tick of the episode, which saves time.
        """
        values = tuple(np.asarray(getattr(self, name)) for name in _FIELDS)
        if kind is None:
            pairs = zip(_FIELDS, values, strict=True)
            kind = np.dtype([(name, value.dtype, value.shape) for name, value in pairs])
        return np.array(values, dtype=kind)

    @staticmethod
    def from_record(record: NDArray[np.void]) -> RecordedTick:
        """Read what ``as_record`` returned.

        Raises:
            ValueError: It is something else.
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
        index: Place in the store, from 0.
        ended: ``"done"``, or what cut it short.
        seqs: The robot's own tick counter at the end of each tick. ``(length,)``
        elapsed: Ticks charged for each, usually 1. ``(length,)``
        episode: The data, in the precision in which they were given.
    """

    index: int
    ended: str
    seqs: NDArray[np.int64]
    elapsed: NDArray[np.int64]
    episode: Episode

    @property
    def header(self) -> EpisodeHeader:
        """What was known before its first tick."""
        return EpisodeHeader(self.epoch, self.policy_source, self.account, self.seed, self.entry)

    def ticks(self) -> list[RecordedTick]:
        """Its ticks, as they were recorded."""
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
        """A sealed archive in NumPy's format, for ``read_episode``."""
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
    """Put recorded ticks together.

    Args:
        start: Observation before the first tick. ``(obs_dim,)``
        desired_goal: ``(goal_dim,)``
        ticks: At least one.
    """
    return Episode(
        observations=np.stack([start, *(tick.observation for tick in ticks)]),
        actions=np.stack([tick.action for tick in ticks]),
        requested_actions=np.stack([tick.requested_action for tick in ticks]),
        valid=np.array([tick.valid for tick in ticks]),
        desired_goal=desired_goal,
    )


def read_episode(path: Path, sealed: bytes, index: int) -> StoredEpisode:
    """Read an episode and check that every byte is as it was written.

    Args:
        path: Its file.
        sealed: What is in it.
        index: Place in the store that it should be of.

    Raises:
        UserError: It is truncated, damaged, or another episode's.
    """
    check_zip(sealed, path, "episode file")
    try:
        with np.load(io.BytesIO(sealed), allow_pickle=False) as file:
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
    """An array in NumPy's file format."""
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def unpack_array(content: bytes) -> NDArray[Any]:
    """Read an array in NumPy's file format.

    Raises:
        ValueError: It is something else, or holds objects.
    """
    array: NDArray[Any] = np.load(io.BytesIO(content), allow_pickle=False)
    return array
