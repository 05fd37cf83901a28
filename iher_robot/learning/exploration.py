"""Exploration: noise on actions, and a second policy that goes to the object."""

from __future__ import annotations

import torch

from iher_robot.learning.config import ExplorationConfig
from iher_robot.learning.contact.approach import ApproachEpisode, ContactPolicy


def explore(
    action: torch.Tensor, config: ExplorationConfig, generator: torch.Generator
) -> torch.Tensor:
    """Add exploration noise to actions, in real and imagined rollouts alike.

    Gaussian noise, then a share of actions replaced by uniform ones (Plappert et al. 2018).

    Args:
        action: The policy's actions. ``(batch, action_dim)``
        config: Amount of noise, share of uniform actions.
        generator: Source of randomness, on the actions' device.

    Returns:
        Actions in [-1, 1]. ``(batch, action_dim)``
    """
    device = action.device
    noise = torch.randn(action.shape, generator=generator, device=device)
    noisy = (action + config.noise_std * noise).clamp(-1.0, 1.0)
    uniform = 2.0 * torch.rand(action.shape, generator=generator, device=device) - 1.0
    replace = torch.rand(len(action), 1, generator=generator, device=device)
    return torch.where(replace < config.random_fraction, uniform, noisy)


class Explorer:
    """Exploration in real episodes. It acts on the CPU.

    Args:
        config: Noise on the actions.
        contact: The policy that goes to the object; None where there is none.
    """

    def __init__(self, config: ExplorationConfig, contact: ContactPolicy | None = None) -> None:
        self.config = config
        self._contact = contact
        self._approach: ApproachEpisode | None = None
        self._episode_begins = True

    def begin(self) -> None:
        """Begin an episode."""
        self._episode_begins = True

    def act(
        self, observation: torch.Tensor, action: torch.Tensor, generator: torch.Generator
    ) -> torch.Tensor:
        """Explore from the policy's action.

        Args:
            observation: ``(1, obs_dim)``
            action: The policy's. ``(1, action_dim)``
            generator: Source of randomness.

        Returns:
            Action to request, in [-1, 1]. ``(1, action_dim)``
        """
        if self._contact is not None and self._episode_begins:
            self._approach = self._contact.begin(observation, generator)
            self._episode_begins = False
        if self._approach is not None:
            towards = self._approach.act(observation, generator)
            if towards is not None:
                return self._approach.restore_hand(
                    towards, explore(towards, self.config, generator)
                )
        return explore(action, self.config, generator)
