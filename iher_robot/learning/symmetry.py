"""Data augmentation with a task's symmetries."""

from __future__ import annotations

import dataclasses
from typing import Protocol

import torch

from iher_robot.learning.transitions import Transitions


class SymmetryMap(Protocol):
    """A map for each row of a batch, which leaves dynamics and reward unchanged."""

    def observation(self, observation: torch.Tensor, /) -> torch.Tensor:
        """Images of observations. ``(batch, obs_dim)``"""

    def action(self, action: torch.Tensor, /) -> torch.Tensor:
        """Images of actions. ``(batch, action_dim)``"""

    def goal(self, goal: torch.Tensor, /) -> torch.Tensor:
        """Images of goals. ``(batch, goal_dim)``"""


class Symmetry(Protocol):
    """The maps of a task, and where they hold."""

    @property
    def draws(self) -> int:
        """Random numbers that choose a row's map."""

    def choose(
        self, uniform: torch.Tensor, start: torch.Tensor, end: torch.Tensor, /
    ) -> SymmetryMap:
        """Map for each step; the identity where none holds.

        Args:
            uniform: Numbers in [0, 1). ``(batch, draws)``
            start: Observations before the step. ``(batch, obs_dim)``
            end: Observations after it. ``(batch, obs_dim)``
        """


def choose_maps(
    symmetry: Symmetry, start: torch.Tensor, end: torch.Tensor, generator: torch.Generator
) -> SymmetryMap:
    """Draw a map for each step.

    Args:
        symmetry: The task's.
        start: Observations before the step. ``(batch, obs_dim)``
        end: Observations after it. ``(batch, obs_dim)``
        generator: Source of randomness, on the observations' device.
    """
    uniform = torch.rand(len(start), symmetry.draws, generator=generator, device=start.device)
    return symmetry.choose(uniform, start, end)


def augment(
    batch: Transitions, symmetry: Symmetry | None, generator: torch.Generator
) -> Transitions:
    """Replace each transition by one of its images; rewards and source stay.

    Args:
        batch: Transitions of any source.
        symmetry: The task's; None leaves the batch as it is.
        generator: Source of randomness, on the batch's device.
    """
    if symmetry is None:
        return batch
    maps = choose_maps(symmetry, batch.observation, batch.next_observation, generator)
    return dataclasses.replace(
        batch,
        observation=maps.observation(batch.observation),
        action=maps.action(batch.action),
        next_observation=maps.observation(batch.next_observation),
        goal=maps.goal(batch.goal),
    )
