"""Actor: chooses the action of each tick from a policy, with exploration or without."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from iher_robot.env.goal_env import Observation
from iher_robot.learning.exploration import Explorer
from iher_robot.learning.goal_model import IMAGINED, REAL
from iher_robot.learning.policy import Policy


class Actor(Protocol):
    """Chooses the actions of an episode.

    Attributes:
        policy_source: Index of the replay source that the policy is conditioned on.
    """

    policy_source: int

    def begin(self, seed: int) -> None:
        """Begin an episode.

        Args:
            seed: Decides every draw of the episode.
        """

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Choose the action of the next tick, in [-1, 1]. ``(action_dim,)``"""


class PolicyActor:
    """Acts with a policy.

    Args:
        policy: A policy on the CPU: one action at a time is no work for a GPU.
        explorer: Disturbs the actions; None leaves them as they are.

    Attributes:
        policy_source: Index of the replay source that the policy is conditioned on.
    """

    def __init__(self, policy: Policy, explorer: Explorer | None = None) -> None:
        self._policy = policy
        self._explorer = explorer
        self._generator = torch.Generator()
        self.policy_source = REAL

    def begin(self, seed: int) -> None:
        """Begin an episode; with an explorer its policy source may be flipped."""
        self._generator = torch.Generator().manual_seed(seed)
        self.policy_source = REAL
        if self._explorer is not None:
            self._explorer.begin()
            if torch.rand((), generator=self._generator) < self._explorer.config.source_flip:
                self.policy_source = IMAGINED

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Choose the action of the next tick, in [-1, 1]. ``(action_dim,)``"""
        obs, goal = _row(observation["observation"]), _row(observation["desired_goal"])
        action = self._policy.act(obs, goal, torch.tensor([self.policy_source]))
        if self._explorer is not None:
            action = self._explorer.act(obs, action, self._generator)
        chosen: NDArray[np.float32] = action[0].numpy()
        return chosen


def _row(values: NDArray[np.floating]) -> torch.Tensor:
    return torch.as_tensor(values, dtype=torch.float32).unsqueeze(0)
