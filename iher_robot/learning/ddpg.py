"""Deep deterministic policy gradients (Lillicrap et al. 2016) on goal-conditioned batches."""

from __future__ import annotations

import copy
from typing import Any

import torch
from torch import nn

from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.critics import Critics
from iher_robot.learning.goal_model import Shapes
from iher_robot.learning.policy import Policy
from iher_robot.learning.replay import Transitions


def target_bounds(config: LearnerConfig) -> list[tuple[float, float]]:
    """Range to which the critics' targets are clipped.

    Without intrinsic rewards no return can lie outside [-1/(1-gamma), 0]; the reference
    implementation of HER clips to it, and so do we unless told otherwise.

    Args:
        config: Discount factor, intrinsic clip, which range, and whether the reward's
            components have critics of their own.

    Returns:
        Lower and upper bound for each component: one for the sum of the rewards, or those of
        extrinsic and intrinsic reward.
    """
    ddpg = config.ddpg
    components = 2 if ddpg.component_critics else 1
    if ddpg.clip_target == "off":
        return [(float("-inf"), float("inf"))] * components
    horizon = 1.0 / (1.0 - ddpg.gamma)
    intrinsic = config.intrinsic.clip * horizon
    if ddpg.component_critics:
        return [(-horizon, 0.0), (0.0, intrinsic)]
    return [(-horizon, intrinsic if ddpg.clip_target == "intrinsic" else 0.0)]


@torch.no_grad()
def _blend(into: nn.Module, source: nn.Module, share: float) -> None:
    torch._foreach_lerp_(list(into.parameters()), list(source.parameters()), share)


class DDPG:
    """Actor, critics, their targets and optimisers.

    Args:
        policy: The policy that is trained, in place.
        shapes: Sizes of the arrays.
        config: Settings.
        generator: Draws the critics' initial weights and the subsets of target critics, on the
            CPU.
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
        bounds = torch.tensor(target_bounds(config), device=device)
        self._low, self._high = bounds[:, :1], bounds[:, 1:]  # (components, 1)
        self.critics = Critics(
            policy.input_dim + shapes.action_dim,
            config.ddpg,
            components=len(bounds),
            generator=generator,
        ).to(device)
        self._generator = generator
        self._updates = 0
        self._target_actor = copy.deepcopy(policy.actor)
        self._mean_actor = copy.deepcopy(policy.actor)
        self._target_critics = copy.deepcopy(self.critics)
        self._actor_optimizer = torch.optim.Adam(
            policy.actor.parameters(), lr=config.ddpg.actor_lr, fused=True
        )
        self._critic_optimizer = torch.optim.Adam(
            self.critics.parameters(), lr=config.ddpg.critic_lr, fused=True
        )

    @torch.no_grad()
    def targets(self, batch: Transitions) -> tuple[torch.Tensor, torch.Tensor]:
        """Bootstrapped targets of the critics.

        Episodes end by time, never by success, so every transition bootstraps.

        Args:
            batch: Transitions.

        Returns:
            Clipped targets, and whether each was clipped. ``(components, batch)`` each
        """
        features = self.policy.features(batch.next_observation, batch.goal, batch.source)
        action = torch.tanh(self._target_actor(features))
        members = self._subset()
        value = self._target_critics(features, action, members).amin(dim=1)
        reward = torch.stack([batch.extrinsic, batch.intrinsic])
        if not self.config.ddpg.component_critics:
            reward = reward.sum(dim=0, keepdim=True)
        raw = reward + self.config.ddpg.gamma * value
        clipped = raw.clamp(self._low, self._high)
        return clipped, clipped != raw

    def _subset(self) -> list[int]:
        count, size = self.config.ddpg.critics, self.config.ddpg.target_subset
        if size == count:
            return list(range(count))
        drawn: list[int] = torch.randperm(count, generator=self._generator)[:size].tolist()
        return drawn

    def update(self, batch: Transitions) -> dict[str, torch.Tensor]:
        """One gradient step of the critics, and of the actor if it is its turn.

        Args:
            batch: Transitions.

        Returns:
            Scalars of the step, as tensors so that a GPU need not wait.
        """
        target, clipped = self.targets(batch)
        features = self.policy.features(batch.observation, batch.goal, batch.source)
        value = self.critics(features, batch.action)
        squared = (value - target.unsqueeze(1)).square()
        critic_loss = squared.mean(dim=-1).sum()  # each network has a loss of its own
        self._critic_optimizer.zero_grad(set_to_none=True)
        critic_loss.backward()
        self._critic_optimizer.step()
        report = {
            "critic_loss": squared.detach().mean(),
            "target_clipped": clipped.float().mean(),
        }
        if self._updates % self.config.ddpg.actor_period == 0:
            report["q"] = self._update_actor(features)
        self._updates += 1
        if (average := self.config.ddpg.policy_average) is not None:
            # At first the plain mean, so that nothing of the initial weights stays in it.
            _blend(self._mean_actor, self.policy.actor, max(average, 1.0 / self._updates))
        if self.config.ddpg.target_update == "update":
            self.update_targets()
        return report

    def _update_actor(self, features: torch.Tensor) -> torch.Tensor:
        action = self.policy.action(features)
        self.critics.requires_grad_(False)  # the actor's gradient passes through, not into them
        value: torch.Tensor = self.critics(features, action).mean(dim=1).sum(dim=0).mean()
        loss = -value + self.config.ddpg.action_l2 * action.square().mean()
        self._actor_optimizer.zero_grad(set_to_none=True)
        loss.backward()
        self._actor_optimizer.step()
        self.critics.requires_grad_(True)
        return value.detach()

    def end_cycle(self) -> None:
        """Move the targets, where they are moved once a cycle."""
        if self.config.ddpg.target_update == "cycle":
            self.update_targets()

    def update_targets(self) -> None:
        """Move the target networks towards the online ones by ``tau``."""
        _blend(self._target_actor, self.policy.actor, self.config.ddpg.tau)
        _blend(self._target_critics, self.critics, self.config.ddpg.tau)

    def acting_snapshot(self) -> dict[str, Any]:
        """Copy of the policy that acts: the actor, or the running mean of its weights."""
        if self.config.ddpg.policy_average is None:
            return self.policy.snapshot()
        weights = {name: t.clone() for name, t in self._mean_actor.state_dict().items()}
        return self.policy.snapshot() | {"actor": weights}

    def _modules(self) -> dict[str, nn.Module]:
        return {
            "critics": self.critics,
            "target_actor": self._target_actor,
            "target_critics": self._target_critics,
            "mean_actor": self._mean_actor,
        }

    def state_dict(self) -> dict[str, Any]:
        """Copy of networks and optimisers, without the policy, which is saved as a snapshot."""
        state: dict[str, Any] = {
            name: module.state_dict() for name, module in self._modules().items()
        }
        state["updates"] = self._updates
        state["generator"] = self._generator.get_state()
        state["actor_optimizer"] = self._actor_optimizer.state_dict()
        state["critic_optimizer"] = self._critic_optimizer.state_dict()
        return copy.deepcopy(state)

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what ``state_dict`` returned."""
        for name, module in self._modules().items():
            module.load_state_dict(state[name])
        self._updates = state["updates"]
        self._generator.set_state(state["generator"].cpu())
        # Optimisers keep the tensors that they load and then write to them.
        self._actor_optimizer.load_state_dict(copy.deepcopy(state["actor_optimizer"]))
        self._critic_optimizer.load_state_dict(copy.deepcopy(state["critic_optimizer"]))
