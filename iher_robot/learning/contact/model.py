"""Positions of effector and object, and when they touch."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch

from iher_robot.learning.goal_model import Array


class ContactModel(Protocol):
    """Positions of effector and object, from the task. Batched over leading axes."""

    @property
    def effector_entries(self) -> tuple[int, ...]:
        """Entries of the observation with the position of the end effector."""

    @property
    def hand_actions(self) -> tuple[int, ...]:
        """Entries of the action that open (1) and close (-1) the hand; empty without a hand."""

    def effector_position(self, observation: torch.Tensor, /) -> torch.Tensor:
        """Position of the end effector, m. ``(..., obs_dim) -> (..., 3)``"""

    def object_position(self, observation: torch.Tensor, /) -> torch.Tensor:
        """Position of the object, m. ``(..., obs_dim) -> (..., 3)``"""


def distance_between(one: torch.Tensor, other: torch.Tensor) -> float:
    """Distance between two positions, m. ``(1, 3)`` each"""
    return float(torch.linalg.vector_norm(one - other, dim=-1).amin())


def touched(
    model: ContactModel,
    start: torch.Tensor,
    observation: torch.Tensor,
    radius_m: float,
    moved_m: float,
) -> bool:
    """Whether the object was touched in any of the observations.

    Args:
        model: Positions of effector and object.
        start: Position of the object before, m. ``(1, 3)``
        observation: ``(ticks, obs_dim)``
        radius_m: It was touched if the effector came this near, m,
        moved_m: or if it moved by more than this, m.
    """
    moved = torch.linalg.vector_norm(model.object_position(observation) - start, dim=-1)
    return bool(((effector_distance(model, observation) < radius_m) | (moved > moved_m)).any())


def effector_distance(model: ContactModel, observation: torch.Tensor) -> torch.Tensor:
    """Distance from effector to object, m. ``(..., obs_dim) -> (...,)``"""
    between = model.effector_position(observation) - model.object_position(observation)
    distance: torch.Tensor = torch.linalg.vector_norm(between, dim=-1)
    return distance


class EffectorGoals:
    """Goal model of the second policy: its achieved goal is the effector's position."""

    def __init__(self, model: ContactModel, radius_m: float) -> None:
        self._model = model
        self._radius_m = radius_m

    def achieved_goal(self, observation: torch.Tensor, /) -> torch.Tensor:
        """Position of the effector, m. ``(..., obs_dim) -> (..., 3)``"""
        return self._model.effector_position(observation)

    def compute_reward(self, achieved: torch.Tensor, desired: torch.Tensor, /) -> torch.Tensor:
        """0 within the radius, else -1. ``(..., 3) -> (...,)``"""
        distance: torch.Tensor = torch.linalg.vector_norm(achieved - desired, dim=-1)
        return -(distance > self._radius_m).float()

    def complete(self, observation: torch.Tensor, /) -> torch.Tensor:
        """Return the observation: nothing is imagined with these goals. ``(..., obs_dim)``"""
        return observation

    def tightened(self, share: float, /) -> EffectorGoals:
        """The same goals within a share of the radius."""
        return EffectorGoals(self._model, share * self._radius_m)

    def sample_goal(self, rng: np.random.Generator, start_observation: Array, /) -> Array:
        """Refuse: this policy's goals are objects and hindsight goals only."""
        raise NotImplementedError
