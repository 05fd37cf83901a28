"""Data-parallel learning: shards of every batch, averaged gradients.

The paper's workers learn so (appendix, "Hyperparameters"), but here all processes hold the same
data and draw the same batches, of which each computes on its shard. The mean of their gradients is
the gradient of the whole batch, and their weights stay equal.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import torch


class Peers(Protocol):
    """The group of learners, as seen by one of them."""

    @property
    def rank(self) -> int:
        """Number of this learner, from 0."""

    @property
    def world_size(self) -> int:
        """Number of learners."""

    def average(self, tensor: torch.Tensor, /) -> None:
        """Replace a tensor in place by its mean over all learners; a collective call."""


class _Alone:
    rank = 0
    world_size = 1

    def average(self, tensor: torch.Tensor, /) -> None:
        """The mean over one learner: leave the tensor as it is."""


ALONE: Peers = _Alone()
"""The group of a single learner."""


def local_rows(block: torch.Tensor, batches: int, peers: Peers) -> torch.Tensor:
    """Rows of each batch that this learner computes on.

    Args:
        block: Batches of one size, concatenated. ``(batches * size, ...)``
        batches: Number of batches.
        peers: The learners.

    Returns:
        An equal shard of each batch. ``(batches * size / peers.world_size, ...)``
    """
    if peers.world_size == 1:
        return block
    assert len(block) % (batches * peers.world_size) == 0, (len(block), batches, peers.world_size)
    shards: torch.Tensor = block.unflatten(0, (batches, peers.world_size, -1))
    return shards[:, peers.rank].flatten(0, 1)


def average_values(values: Mapping[str, torch.Tensor], peers: Peers) -> dict[str, torch.Tensor]:
    """Mean over all learners of named vectors, in one collective call. ``(steps,)`` each"""
    if peers.world_size == 1:
        return dict(values)
    joined = torch.cat(list(values.values()))
    peers.average(joined)
    parts = joined.split([len(each) for each in values.values()])
    return dict(zip(values, parts, strict=True))


def require_equal_shards(name: str, size: int, peers: Peers) -> None:
    """Check that a batch divides into equal shards.

    Args:
        name: Settings that give the size, for the message.
        size: Rows of the batch.
        peers: The learners.

    Raises:
        ValueError: It does not.
    """
    if size % peers.world_size:
        raise ValueError(
            f"{name} is {size}, which {peers.world_size} processes cannot share equally, "
            f"allowed: a multiple of {peers.world_size}; change it, or start another number "
            "of processes"
        )
