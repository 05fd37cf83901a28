"""Batches of transitions, as replay samples them and the policy learns from them."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from iher_robot.learning.networks.data_parallel import Peers, local_rows

BLOCK = 40
"""Batches that are sampled together: one costs almost as much."""


@dataclass(frozen=True)
class Transitions:
    """A batch of transitions with goals and reward components.

    Attributes:
        observation: ``(batch, obs_dim)``
        action: ``(batch, action_dim)``
        next_observation: ``(batch, obs_dim)``
        goal: Desired goal, relabelled or original. ``(batch, goal_dim)``
        extrinsic: Sparse reward of the next observation under that goal. ``(batch,)``
        intrinsic: Cached curiosity reward. ``(batch,)``
        source: Index of the source. ``(batch,)``
    """

    observation: torch.Tensor
    action: torch.Tensor
    next_observation: torch.Tensor
    goal: torch.Tensor
    extrinsic: torch.Tensor
    intrinsic: torch.Tensor
    source: torch.Tensor

    @staticmethod
    def interleave(parts: list[Transitions], count: int) -> Transitions:
        """Merge blocks of several sources, so that each batch has the same share of every source.

        Args:
            parts: One block a source: ``count`` batches, concatenated.
            count: Batches.
        """

        def joined(field: str) -> torch.Tensor:
            batches = [getattr(part, field).unflatten(0, (count, -1)) for part in parts]
            return torch.cat(batches, dim=1).flatten(0, 1)

        return Transitions(**{field: joined(field) for field in Transitions.__dataclass_fields__})

    def split(self, count: int) -> list[Transitions]:
        """Split into equal batches."""
        assert len(self.source) % count == 0, (len(self.source), count)
        fields = Transitions.__dataclass_fields__
        chunks = zip(*(getattr(self, f).chunk(count) for f in fields), strict=True)
        return [Transitions(*chunk) for chunk in chunks]

    def shard(self, count: int, peers: Peers) -> Transitions:
        """Rows of each batch that this learner computes on.

        Args:
            count: Batches, concatenated.
            peers: The learners.
        """
        if peers.world_size == 1:
            return self
        fields = Transitions.__dataclass_fields__
        return Transitions(**{f: local_rows(getattr(self, f), count, peers) for f in fields})
