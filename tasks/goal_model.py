"""Goals and rewards as pure functions of observations, measured or imagined."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from typing import Self

import numpy as np
from numpy.typing import NDArray

from tasks.arrays import ArrayT, FloatArray, square_root
from tasks.errors import MissingObject
from tasks.layout import ObservationLayout


class GoalModel(ABC):
    """Pure functions, batched over leading axes, on numpy arrays and torch tensors alike.

    The learner also calls them on imagined observations.
    """

    def __init__(
        self,
        layout: ObservationLayout,
        achieved: str,
        threshold: float,
        hand_actions: tuple[int, ...] = (),
    ) -> None:
        """Define the goals by an entry of the observation.

        Args:
            layout: Layout of the observations.
            achieved: Name of the entry that is compared with the goal.
            threshold: Distance within which a goal is reached, m.
            hand_actions: Indices of the action that open a hand, at 1, and close it, at -1.
        """
        self.layout = layout
        self.threshold = threshold
        self.hand_actions = hand_actions
        self._achieved_entry = achieved
        self._achieved = layout.slices[achieved]

    @property
    def goal_dim(self) -> int:
        """Length of a goal."""
        return dict(self.layout.sizes)[self._achieved_entry]

    @property
    def achieved_entries(self) -> tuple[int, ...]:
        """Indices of an observation that a goal is compared with."""
        return self.layout.entries(self._achieved_entry)

    @property
    def effector_entries(self) -> tuple[int, ...]:
        """Indices of an observation with the position of the end effector."""
        return self.layout.entries(self.layout.effector)

    @abstractmethod
    def sample_goal(self, rng: np.random.Generator, start_obs: FloatArray) -> NDArray[np.float64]:
        """Draw a goal for each start.

        Args:
            rng: Source of randomness.
            start_obs: Observations measured at the start. ``(batch, obs_dim)``

        Returns:
            Goals, m, in the robot's frame. ``(batch, goal_dim)``
        """

    def achieved_goal(self, obs: ArrayT) -> ArrayT:
        """Return the goal that an observation achieves.

        Args:
            obs: Observations. ``(..., obs_dim)``

        Returns:
            Goals, m, in the robot's frame. ``(..., goal_dim)``
        """
        return obs[..., self._achieved]

    def effector_position(self, obs: ArrayT) -> ArrayT:
        """Return the position of the end effector, m, in the robot's frame. ``(..., 3)``"""
        return obs[..., self.layout.slices[self.layout.effector]]

    def object_position(self, obs: ArrayT) -> ArrayT:
        """Return the position of the object, m, in the robot's frame. ``(..., 3)``

        Raises:
            MissingObject: If the layout has no object.
        """
        if self.layout.object_entry is None:
            raise MissingObject(f"the layout {list(self.layout.names)} has no object")
        return obs[..., self.layout.slices[self.layout.object_entry]]

    def distance(self, achieved: ArrayT, desired: ArrayT) -> ArrayT:
        """Return the distance between goals, m. ``(...,)``"""
        difference = achieved - desired
        squared: ArrayT = (difference * difference).sum(-1)
        return square_root(squared)

    def compute_reward(self, achieved: ArrayT, desired: ArrayT) -> ArrayT:
        """Return the sparse reward.

        Args:
            achieved: Goals achieved. ``(..., goal_dim)``
            desired: Goals desired. ``(..., goal_dim)``

        Returns:
            0 within the threshold, else -1. ``(...,)``

        Source: ``compute_reward`` of `gymnasium_robotics/envs/fetch/fetch_env.py`.
        """
        missed = self.distance(achieved, desired) > self.threshold
        return missed * -1.0 + 0.0  # the sum turns -0.0 into 0.0

    def is_success(self, achieved: ArrayT, desired: ArrayT) -> ArrayT:
        """Return 1 where a goal is reached, else 0. ``(...,)``"""
        return (self.distance(achieved, desired) < self.threshold) * 1.0

    def tightened(self, share: float) -> Self:
        """Return the same goals with a stricter reward, for learning.

        Args:
            share: Factor on the threshold, above 0 and at most 1.
        """
        strict = copy.copy(self)
        strict.threshold = share * self.threshold
        return strict

    def complete(self, obs: ArrayT) -> ArrayT:
        """Recompute the derived entries, such as the object's position relative to the gripper.

        Args:
            obs: Observations, such as imagined ones. ``(..., obs_dim)``

        Returns:
            A new array or tensor. ``(..., obs_dim)``
        """
        return self.layout.complete(obs)
