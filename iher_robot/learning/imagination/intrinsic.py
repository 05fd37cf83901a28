"""Intrinsic reward: disagreement of the dynamics ensemble (paper, section III.D)."""

from __future__ import annotations

import torch

from iher_robot.learning.config import IntrinsicConfig
from iher_robot.learning.imagination.dynamics import DynamicsEnsemble
from iher_robot.learning.replay import EpisodeReplay

CHUNK = 16_384
"""Transitions that are predicted at once."""


def disagreement(predictions: torch.Tensor, config: IntrinsicConfig) -> torch.Tensor:
    """Variance of the members' predictions.

    The population variance over members of the normalised change; in metres it would be about 0.

    Args:
        predictions: ``(members, batch, obs_dim)``
        config: How the dimensions are reduced.

    Returns:
        sigma_t. ``(batch,)``
    """
    # ``var(dim=0)`` takes thirty times as long on a CPU.
    variance = (predictions - predictions.mean(dim=0)).square().mean(dim=0)
    return variance.sum(-1) if config.reduce == "sum" else variance.mean(-1)


def intrinsic_reward(sigma: torch.Tensor, config: IntrinsicConfig) -> torch.Tensor:
    """clip(nu sigma, 0, eta). ``(batch,)``"""
    return (config.scale * sigma).clamp(0.0, config.clip)


def refresh_intrinsic(
    replay: EpisodeReplay, ensemble: DynamicsEnsemble, config: IntrinsicConfig
) -> torch.Tensor:
    """Recompute the cached reward of every stored transition.

    The reward depends on observation, action and ensemble only, so it stays exact until the
    ensemble is trained again.

    Args:
        replay: Source to refresh.
        ensemble: The models.
        config: Scale and clip.

    Returns:
        The rewards. ``(transitions,)``
    """
    episodes, ticks = replay.all_indices()
    rewards = []
    for episode, tick in zip(episodes.split(CHUNK), ticks.split(CHUNK), strict=True):
        observation, action, _ = replay.steps(episode, tick)
        sigma = disagreement(ensemble.predict(observation, action), config)
        rewards.append(intrinsic_reward(sigma, config))
    reward = torch.cat(rewards)
    replay.store_intrinsic(episodes, ticks, reward)
    return reward
