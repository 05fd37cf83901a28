"""Deep deterministic policy gradient (Lillicrap et al. 2016) on goal-conditioned batches."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import torch

from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.goal_model import Shapes
from iher_robot.learning.networks.actor_critic import ActorCritic
from iher_robot.learning.networks.critics import Critics
from iher_robot.learning.networks.cuda_graphs import CudaGraphs, Tensors
from iher_robot.learning.networks.data_parallel import ALONE, Peers, average_values
from iher_robot.learning.policy import Policy
from iher_robot.learning.transitions import Transitions


def target_bounds(config: LearnerConfig) -> list[tuple[float, float]]:
    """Range to which the critics' targets are clipped.

    Without intrinsic rewards no return lies outside [-1/(1-gamma), 0]; the reference
    implementation of HER clips to it, which is the default here.

    Args:
        config: Discount factor, intrinsic clip, which range, and whether each component of the
            reward has its own critics.

    Returns:
        Lower and upper bound of each component: one for the sum of the rewards, or one each for
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


@dataclass(frozen=True)
class Minibatches:
    """Minibatches of several gradient steps, as the networks see them.

    Attributes:
        features: Of observation and goal. ``(steps, batch, input_dim)``
        action: ``(steps, batch, action_dim)``
        next_features: Of next observation and goal. ``(steps, batch, input_dim)``
        reward: Of each component. ``(steps, components, batch)``
        target_subsets: Target critics that each step bootstraps from; None for all of them.
    """

    features: torch.Tensor
    action: torch.Tensor
    next_features: torch.Tensor
    reward: torch.Tensor
    target_subsets: list[list[int]] | None = None


class DDPG:
    """Off-policy learner: trains a policy on batches of transitions.

    Args:
        policy: The policy, trained in place.
        shapes: Sizes of the arrays.
        config: Settings.
        generator: Draws the critics' initial weights and the subsets of target critics, on the
            CPU.
        device: Where the networks compute.
        peers: Learners with which it shares every batch.
    """

    def __init__(
        self,
        policy: Policy,
        shapes: Shapes,
        config: LearnerConfig,
        *,
        generator: torch.Generator,
        device: torch.device,
        peers: Peers = ALONE,
    ) -> None:
        self.policy = policy
        self.config = config
        self._peers = peers
        self._generator = generator
        bounds = torch.tensor(target_bounds(config), device=device)
        self._low, self._high = bounds[:, :1], bounds[:, 1:]  # (components, 1)
        self.critics = Critics(
            policy.input_dim + shapes.action_dim,
            config.ddpg,
            components=len(bounds),
            generator=generator,
            matmul_dtype=policy.matmul_dtype,
        ).to(device)
        # A graph cannot capture communication with other processes.
        captures = config.cuda_graphs and device.type == "cuda" and peers.world_size == 1
        self._graphs = CudaGraphs() if captures else None
        self._networks = ActorCritic(
            policy.actor, self.critics, config.ddpg, capturable=captures, peers=peers
        )
        self._updates = torch.zeros((), dtype=torch.long, device=device)
        self._phase = 0  # updates modulo actor_period, on the host

    def update(self, batch: Transitions) -> dict[str, torch.Tensor]:
        """Take one gradient step; ``update_block`` with one batch."""
        return self.update_block(batch, 1)

    def update_block(self, block: Transitions, count: int) -> dict[str, torch.Tensor]:
        """Take gradient steps, one for each batch of a block.

        Args:
            block: Batches of equal size, concatenated; the same for all peers, each of which
                computes on its shard.
            count: Batches.

        Returns:
            Metrics of each step, and of each actor step; tensors, so that a GPU need not wait.
            ``(steps,)``
        """
        batches, phase = self._minibatches(block.shard(count, self._peers), count), self._phase
        self._phase = (phase + count) % self.config.ddpg.actor_period
        if self._graphs is None or batches.target_subsets is not None:
            return average_values(self._train(batches, phase), self._peers)

        def train(inputs: Tensors) -> dict[str, torch.Tensor]:
            features, action, next_features, reward = inputs
            return self._train(Minibatches(features, action, next_features, reward), phase)

        inputs = (batches.features, batches.action, batches.next_features, batches.reward)
        return self._graphs.run((count, phase), inputs, train)

    def _train(self, batches: Minibatches, phase: int) -> dict[str, torch.Tensor]:
        """Take the gradient steps; ``phase`` counts updates since the actor's turn."""
        config, networks = self.config.ddpg, self._networks
        metrics: dict[str, list[torch.Tensor]] = defaultdict(list)
        for step, features in enumerate(batches.features):
            # Critics: regression on the bootstrapped targets. Each network has its own loss.
            target, clipped = self._targets(batches, step)
            value = self.critics(features, batches.action[step])
            squared_error = (value - target.unsqueeze(1)).square()
            networks.gradient_step("critics", squared_error.mean(dim=-1).sum())
            metrics["critic_loss"].append(squared_error.detach().mean())
            metrics["target_clipped"].append(clipped.float().mean())

            # Actor: ascent on the critics' mean, with a penalty on large actions.
            if (phase + step) % config.actor_period == 0:
                action = self.policy.action(features)
                q = self.critics(features, action).mean(dim=1).sum(dim=0).mean()
                networks.gradient_step("actor", -q + config.action_l2 * action.square().mean())
                metrics["q"].append(q.detach())

            # Running mean of the actor's weights: at first the plain mean, which forgets the
            # initial weights.
            self._updates += 1
            if config.policy_average is not None:
                share = self._updates.float().reciprocal().clamp(min=config.policy_average)
                networks.update_mean_actor(share)

            # Target networks.
            if config.target_update == "update":
                self.update_targets()
        return {name: torch.stack(values) for name, values in metrics.items()}

    @torch.no_grad()
    def _targets(self, batches: Minibatches, step: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Clipped targets, and whether each was clipped. ``(components, batch)`` each"""
        # Episodes end by time, never by success, so that every transition bootstraps.
        features = batches.next_features[step]
        action = self.policy.action(features, self._networks.target_actor)
        subset = None if batches.target_subsets is None else batches.target_subsets[step]
        value = self._networks.target_critics(features, action, subset).amin(dim=1)
        unclipped = batches.reward[step] + self.config.ddpg.gamma * value
        target = unclipped.clamp(self._low, self._high)
        return target, target != unclipped

    @torch.no_grad()
    def _minibatches(self, block: Transitions, count: int) -> Minibatches:
        # For all steps at once: only the networks change from one step to the next.
        def per_step(rows: torch.Tensor) -> torch.Tensor:
            steps: torch.Tensor = rows.unflatten(0, (count, -1))
            return steps

        features = self.policy.features
        reward = torch.stack([block.extrinsic, block.intrinsic])
        if not self.config.ddpg.component_critics:
            reward = reward.sum(dim=0, keepdim=True)
        return Minibatches(
            features=per_step(features(block.observation, block.goal, block.source)),
            action=per_step(block.action),
            next_features=per_step(features(block.next_observation, block.goal, block.source)),
            reward=reward.unflatten(1, (count, -1)).transpose(0, 1),
            target_subsets=self._draw_target_subsets(count),
        )

    def _draw_target_subsets(self, count: int) -> list[list[int]] | None:
        critics, size = self.config.ddpg.critics, self.config.ddpg.target_subset
        if size == critics:
            return None
        orders = (torch.randperm(critics, generator=self._generator) for _ in range(count))
        return [order[:size].tolist() for order in orders]

    def end_cycle(self) -> None:
        """Update the target networks, if they are updated once a cycle."""
        if self.config.ddpg.target_update == "cycle":
            self.update_targets()

    def update_targets(self) -> None:
        """Move the target networks towards the online ones by ``tau``."""
        self._networks.update_targets()

    def acting_snapshot(self) -> dict[str, Any]:
        """Copy of the policy that acts: the actor, or the running mean of its weights."""
        if self.config.ddpg.policy_average is None:
            return self.policy.snapshot()
        mean = self._networks.mean_actor.state_dict()
        return self.policy.snapshot() | {"actor": {name: t.clone() for name, t in mean.items()}}

    def state_dict(self) -> dict[str, Any]:
        """Copy of networks and optimisers, without the policy, which is saved as a snapshot."""
        return self._networks.state_dict() | {
            "updates": int(self._updates),
            "generator": self._generator.get_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what ``state_dict`` returned."""
        self._networks.load_state_dict(state)
        self._updates.fill_(state["updates"])
        self._phase = state["updates"] % self.config.ddpg.actor_period
        self._generator.set_state(state["generator"].cpu())
        if self._graphs is not None:
            self._graphs.clear()
