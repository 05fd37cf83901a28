"""Layout of an observation vector: named slices, and entries derived from others."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property

from tasks.arrays import ArrayT, copied


@dataclass(frozen=True)
class Difference:
    """An entry derived from two others: ``target = minuend - subtrahend``."""

    target: str
    minuend: str
    subtrahend: str


@dataclass(frozen=True)
class ObservationLayout:
    """Named slices of an observation vector.

    Attributes:
        sizes: Name and length of each entry, in order.
        derived: Entries derived from others.
        effector: Entry with the position of the end effector.
        object_entry: Entry with the position of the object, None without one.
    """

    sizes: tuple[tuple[str, int], ...]
    derived: tuple[Difference, ...] = ()
    effector: str = "gripper_pos"
    object_entry: str | None = None

    def __post_init__(self) -> None:
        if len(self.slices) != len(self.sizes):
            raise ValueError(f"entries are {self.names}, allowed: names that are all different")
        used = [name for entry in self.derived for name in vars(entry).values()]
        used += [self.effector] if self.object_entry is None else [self.effector, self.object_entry]
        missing = sorted(set(used) - set(self.names))
        if missing:
            raise ValueError(f"layout has no entry {missing}, entries: {list(self.names)}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the entries in order."""
        return tuple(name for name, _ in self.sizes)

    @property
    def obs_dim(self) -> int:
        """Length of the vector."""
        return sum(size for _, size in self.sizes)

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Slice of each entry."""
        found, start = {}, 0
        for name, size in self.sizes:
            found[name] = slice(start, start + size)
            start += size
        return found

    def entries(self, name: str) -> tuple[int, ...]:
        """Return the indices of an entry."""
        return tuple(range(self.obs_dim)[self.slices[name]])

    def complete(self, obs: ArrayT) -> ArrayT:
        """Recompute the derived entries.

        Args:
            obs: Observations. ``(..., obs_dim)``

        Returns:
            A new array or tensor. ``(..., obs_dim)``
        """
        result = copied(obs)
        for entry in self.derived:
            minuend = result[..., self.slices[entry.minuend]]
            subtrahend = result[..., self.slices[entry.subtrahend]]
            result[..., self.slices[entry.target]] = minuend - subtrahend
        return result

    def to_dict(self) -> dict[str, object]:
        """Return the layout as plain JSON data."""
        return {
            "sizes": [[name, size] for name, size in self.sizes],
            "derived": [[e.target, e.minuend, e.subtrahend] for e in self.derived],
            "effector": self.effector,
            "object": self.object_entry,
        }

    def digest(self) -> str:
        """Return the SHA-256 of the layout, 64 hexadecimal digits."""
        text = json.dumps(self.to_dict(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()
