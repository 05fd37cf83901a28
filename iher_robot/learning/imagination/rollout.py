"""Imaginary rollouts through the dynamics ensemble (paper, section III.B)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from iher_robot.learning.goal_model import GoalModel
from iher_robot.learning.imagination.dynamics import DynamicsEnsemble

ActionRule = Callable[[torch.Tensor], torch.Tensor]
"""Maps observations ``(batch, obs_dim)`` to actions ``(batch, action_dim)``."""


@dataclass(frozen=True)
class ImaginedRollouts:
    """Imagined episodes of one length.

    Attributes:
        observations: ``(episodes, length + 1, obs_dim)``
        actions: ``(episodes, length, action_dim)``
        goals: ``(episodes, goal_dim)``
        spreads: ``spread`` of each transition's predictions. ``(episodes, length)``
        dropped: Rollouts left out because an observation or a prediction was not finite.
    """

    observations: torch.Tensor
    actions: torch.Tensor
    goals: torch.Tensor
    spreads: torch.Tensor
    dropped: int


@torch.no_grad()
def imagine(
    ensemble: DynamicsEnsemble,
    goal_model: GoalModel,
    *,
    start: torch.Tensor,
    goals: torch.Tensor,
    act: ActionRule,
    ticks: int,
    state_margin: float,
    spread: Callable[[torch.Tensor], torch.Tensor],
    generator: torch.Generator,
) -> ImaginedRollouts:
    """Roll out a policy in the models: each step of each rollout draws a member uniformly.

    Args:
        ensemble: The models.
        goal_model: Recomputes derived entries of the observation.
        start: First observations. ``(episodes, obs_dim)``
        goals: Desired goals. ``(episodes, goal_dim)``
        act: The policy, with exploration if any.
        ticks: Length of the rollouts.
        state_margin: Observations are clipped to the real data's range, widened by this share.
        spread: Maps the members' predictions ``(members, batch, obs_dim)`` to one number a
            row, such as the intrinsic reward.
        generator: Draws the members.

    Returns:
        The rollouts whose observations are all finite.
    """
    margin = state_margin * (ensemble.obs_high - ensemble.obs_low)
    low, high = ensemble.obs_low - margin, ensemble.obs_high + margin
    members = len(ensemble.members)
    rows = torch.arange(len(start), device=start.device)
    observations, actions, spreads = [start], [], []
    finite = start.isfinite().all(-1)
    for _ in range(ticks):
        action = act(observations[-1])
        predictions = ensemble.predict(observations[-1], action)
        # Checked before bounding, which would turn an infinite prediction into a finite one.
        finite &= predictions.sum(dim=0).sum(dim=-1).isfinite()
        member = torch.randint(members, rows.shape, generator=generator, device=rows.device)
        following = ensemble.next_observation(observations[-1], predictions[member, rows])
        following = goal_model.complete(torch.clamp(following, low, high))
        observations.append(following)
        actions.append(action)
        spreads.append(spread(predictions))
    stacked = torch.stack(observations, dim=1)
    return ImaginedRollouts(
        observations=stacked[finite],
        actions=torch.stack(actions, dim=1)[finite],
        goals=goals[finite],
        spreads=torch.stack(spreads, dim=1)[finite],
        dropped=int((~finite).sum()),
    )
