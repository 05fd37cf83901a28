"""What disturbs the policy's actions while real episodes are collected."""

from __future__ import annotations

import torch

from iher_robot.learning.config import ExplorationConfig
from iher_robot.learning.contact.approach import ApproachEpisode, ContactPolicy
from iher_robot.learning.policy import explore


class Explorer:
    """Noise, and a policy that goes to the object. It acts on the CPU.

    Args:
        config: Noise on the actions.
        contact: The second policy; None where there is none.
    """

    def __init__(self, config: ExplorationConfig, contact: ContactPolicy | None = None) -> None:
        self.config = config
        self._contact = contact
        self._play: ApproachEpisode | None = None
        self._fresh = True

    def begin(self) -> None:
        """Begin an episode."""
        self._fresh = True

    def act(
        self, observation: torch.Tensor, action: torch.Tensor, generator: torch.Generator
    ) -> torch.Tensor:
        """Choose what is done in place of the policy's action.

        Args:
            observation: ``(1, obs_dim)``
            action: The policy's. ``(1, action_dim)``
            generator: Source of randomness.

        Returns:
            Action in [-1, 1]. ``(1, action_dim)``
        """
        if self._contact is not None:
            if self._fresh:
                self._play, self._fresh = self._contact.begin(observation, generator), False
            towards = None if self._play is None else self._play.act(observation, generator)
            if self._play is not None and towards is not None:
                return self._play.steady(towards, explore(towards, self.config, generator))
        return explore(action, self.config, generator)
