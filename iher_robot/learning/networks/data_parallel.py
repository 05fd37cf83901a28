"""Several learners that are one: each computes on its share of every batch, gradients are averaged.

So the paper's workers learn (appendix, "Hyperparameters"), but that all hold the same data, draw
the same batches, and each computes the gradient of its own rows alone. The mean over the learners
is then the gradient of the whole batch, and their weights stay the same.
"""

from __future__ import annotations

from typing import Protocol

import torch


class Peers(Protocol):
    """The learners of a run, as one of them sees them."""

    @property
    def rank(self) -> int:
        """Number of this one, from 0."""

    @property
    def world_size(self) -> int:
        """How many there are."""

    def average(self, tensor: torch.Tensor, /) -> None:
        """Replace a tensor by the mean of all learners' in place; each has to come to it."""


class _Alone:
    rank = 0
    world_size = 1

    def average(self, tensor: torch.Tensor, /) -> None:
        """The mean of one is what it is."""


ALONE: Peers = _Alone()
"""A learner that is the only one."""


def own_rows(block: torch.Tensor, batches: int, peers: Peers) -> torch.Tensor:
    """The rows of each batch that this learner computes on.

    Args:
        block: Batches of one size, one behind the other. ``(batches * size, ...)``
        batches: How many.
        peers: The learners.

    Returns:
        An equal share of each batch. ``(batches * size / peers.world_size, ...)``
    """
    if peers.world_size == 1:
        return block
    assert len(block) % (batches * peers.world_size) == 0, (len(block), batches, peers.world_size)
    shares: torch.Tensor = block.unflatten(0, (batches, peers.world_size, -1))
    return shares[:, peers.rank].flatten(0, 1)


def require_equal_shares(name: str, size: int, peers: Peers) -> None:
    """Check that a batch can be shared.

    Args:
        name: What the size is made of, for the message.
        size: Rows of the batch.
        peers: The learners.

    Raises:
        ValueError: The shares would not be equal.
    """
    if size % peers.world_size:
        raise ValueError(
            f"{name} is {size}, which {peers.world_size} processes cannot share equally, "
            f"allowed: a multiple of {peers.world_size}; change it, or start another number "
            "of processes"
        )
