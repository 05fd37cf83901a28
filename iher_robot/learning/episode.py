"""A real episode, as the learner receives it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]


@dataclass(frozen=True)
class Episode:
    """Transitions under one desired goal.

    Attributes:
        observations: Observations, the last one after the last action. ``(length + 1, obs_dim)``
        actions: Actions as the robot applied them, in [-1, 1]. ``(length, action_dim)``
        requested_actions: Actions as the policy requested them. ``(length, action_dim)``
        valid: Whether the tick may be learned from; a held, dropped or late tick may not, though
            it is charged to the budget. ``(length,)``
        desired_goal: The goal. ``(goal_dim,)``
    """

    observations: FloatArray
    actions: FloatArray
    requested_actions: FloatArray
    valid: NDArray[np.bool_]
    desired_goal: FloatArray

    def __post_init__(self) -> None:
        length = len(self.actions)
        shapes = (len(self.observations), len(self.requested_actions), len(self.valid))
        if shapes != (length + 1, length, length):
            raise ValueError(
                f"an episode of {length} actions has {length + 1} observations, {length} "
                f"requested actions and {length} valid flags, not {shapes}"
            )

    def __len__(self) -> int:
        """Ticks of the episode, valid or not."""
        return len(self.actions)

    def segments(self) -> list[Episode]:
        """Split at invalid ticks, so that neither a transition nor hindsight spans one.

        Returns:
            Maximal runs of valid ticks, in order; empty if there is none.
        """
        padded = np.concatenate([[False], self.valid, [False]])
        edges = np.flatnonzero(padded[1:] != padded[:-1])
        return [
            Episode(
                observations=self.observations[start : stop + 1],
                actions=self.actions[start:stop],
                requested_actions=self.requested_actions[start:stop],
                valid=self.valid[start:stop],
                desired_goal=self.desired_goal,
            )
            for start, stop in zip(edges[::2], edges[1::2], strict=True)
        ]
