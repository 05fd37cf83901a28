"""Deep deterministic policy gradients (Lillicrap et al. 2016) on goal-conditioned batches."""

from __future__ import annotations

import copy
from typing import Any

import torch
from torch import nn

from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.goal_model import Shapes
from iher_robot.learning.networks import mlp
from iher_robot.learning.policy import Policy
from iher_robot.learning.replay import Transitions


def target_bounds(config: LearnerConfig) -> tuple[float, float]:
    """Range to which the critic's targets are clipped.

    Without intrinsic rewards no return can lie outside [-1/(1-gamma), 0]; the reference
    implementation of HER clips to it, and so do we unless told otherwise.

    Args:
        config: Discount factor, intrinsic clip and which range.

    Returns:
        Lower and upper bound.
    """
    if config.ddpg.clip_target == "off":
        return float("-inf"), float("inf")
    horizon = 1.0 / (1.0 - config.ddpg.gamma)
    upper = config.intrinsic.clip * horizon if config.ddpg.clip_target == "intrinsic" else 0.0
    return -horizon, upper


class DDPG:
    """Actor, critic, their targets and optimisers.

    Args:
        policy: The policy that is trained, in place.
        shapes: Sizes of the arrays.
        config: Settings.
        generator: Draws the critic's initial weights, on the CPU.
        device: Where the networks compute.
    """

    def __init__(
        self,
        policy: Policy,
        shapes: Shapes,
        config: LearnerConfig,
        *,
        generator: torch.Generator,
        device: torch.device,
    ) -> None:
        self.policy = policy
        self.config = config
        self.bounds = target_bounds(config)
        inputs = policy.input_dim + shapes.action_dim
        self.critic = mlp(inputs, config.ddpg.hidden, 1, generator).to(device)
        self._target_actor = copy.deepcopy(policy.actor)
        self._target_critic = copy.deepcopy(self.critic)
        self._actor_optimizer = torch.optim.Adam(
            policy.actor.parameters(), lr=config.ddpg.actor_lr, fused=True
        )
        self._critic_optimizer = torch.optim.Adam(
            self.critic.parameters(), lr=config.ddpg.critic_lr, fused=True
        )

    @torch.no_grad()
    def targets(self, batch: Transitions) -> tuple[torch.Tensor, torch.Tensor]:
        """Bootstrapped targets of the critic.

        Episodes end by time, never by success, so every transition bootstraps.

        Args:
            batch: Transitions.

        Returns:
            Clipped targets ``(batch,)``, and whether each was clipped ``(batch,)``.
        """
        features = self.policy.features(batch.next_observation, batch.goal, batch.source)
        action = torch.tanh(self._target_actor(features))
        value = self._target_critic(torch.cat([features, action], dim=-1)).squeeze(-1)
        reward = batch.extrinsic + batch.intrinsic
        raw = reward + self.config.ddpg.gamma * value
        clipped = raw.clamp(*self.bounds)
        return clipped, clipped != raw

    def update(self, batch: Transitions) -> dict[str, torch.Tensor]:
        """One gradient step of critic and actor.

        Args:
            batch: Transitions.

        Returns:
            Scalars of the step, as tensors so that a GPU need not wait.
        """
        target, clipped = self.targets(batch)
        features = self.policy.features(batch.observation, batch.goal, batch.source)
        value = self.critic(torch.cat([features, batch.action], dim=-1)).squeeze(-1)
        critic_loss = (value - target).square().mean()
        self._critic_optimizer.zero_grad(set_to_none=True)
        critic_loss.backward()
        self._critic_optimizer.step()

        action = self.policy.action(features)
        self.critic.requires_grad_(False)  # the actor's gradient passes through, not into it
        value_of_policy = self.critic(torch.cat([features, action], dim=-1)).mean()
        actor_loss = -value_of_policy + self.config.ddpg.action_l2 * action.square().mean()
        self._actor_optimizer.zero_grad(set_to_none=True)
        actor_loss.backward()
        self._actor_optimizer.step()
        self.critic.requires_grad_(True)
        return {
            "critic_loss": critic_loss.detach(),
            "q": value_of_policy.detach(),
            "target_clipped": clipped.float().mean(),
        }

    @torch.no_grad()
    def update_targets(self) -> None:
        """Move the target networks towards the online ones by ``tau``."""
        for target, online in (
            (self._target_actor, self.policy.actor),
            (self._target_critic, self.critic),
        ):
            torch._foreach_lerp_(
                list(target.parameters()), list(online.parameters()), self.config.ddpg.tau
            )

    def _modules(self) -> dict[str, nn.Module]:
        return {
            "critic": self.critic,
            "target_actor": self._target_actor,
            "target_critic": self._target_critic,
        }

    def state_dict(self) -> dict[str, Any]:
        """Copy of networks and optimisers, without the policy, which is saved as a snapshot."""
        state = {name: module.state_dict() for name, module in self._modules().items()}
        state["actor_optimizer"] = self._actor_optimizer.state_dict()
        state["critic_optimizer"] = self._critic_optimizer.state_dict()
        return copy.deepcopy(state)

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what ``state_dict`` returned."""
        for name, module in self._modules().items():
            module.load_state_dict(state[name])
        # Optimisers keep the tensors that they load and then write to them.
        self._actor_optimizer.load_state_dict(copy.deepcopy(state["actor_optimizer"]))
        self._critic_optimizer.load_state_dict(copy.deepcopy(state["critic_optimizer"]))
