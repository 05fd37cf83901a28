"""Deep deterministic policy gradients (Lillicrap et al. 2016) on goal-conditioned batches."""

from __future__ import annotations

import copy
from collections import defaultdict
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from torch import nn

from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.goal_model import Shapes
from iher_robot.learning.networks.critics import Critics
from iher_robot.learning.networks.cuda_graphs import Captured, Tensors
from iher_robot.learning.networks.data_parallel import ALONE, Peers
from iher_robot.learning.networks.flat_parameters import Flat
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


@dataclass(frozen=True)
class Steps:
    """What the networks see of some gradient steps; slices of it are what they see of one.

    Attributes:
        features: Of observation and goal. ``(steps, batch, input_dim)``
        action: ``(steps, batch, action_dim)``
        next_features: Of next observation and goal. ``(steps, batch, input_dim)``
        reward: Of each component. ``(steps, components, batch)``
        members: Target critics that each step bootstraps from; None for all of them.
    """

    features: torch.Tensor
    action: torch.Tensor
    next_features: torch.Tensor
    reward: torch.Tensor
    members: list[list[int]] | None = None


class DDPG:
    """Actor, critics, their targets and optimisers.

    Args:
        policy: The policy that is trained, in place.
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
        self._peers = peers
        self.config = config
        bounds = torch.tensor(target_bounds(config), device=device)
        self._low, self._high = bounds[:, :1], bounds[:, 1:]  # (components, 1)
        self.critics = Critics(
            policy.input_dim + shapes.action_dim,
            config.ddpg,
            components=len(bounds),
            generator=generator,
            products=policy.products,
        ).to(device)
        self._generator = generator
        self._updates = torch.zeros((), dtype=torch.long, device=device)
        self._phase = 0
        self._target_actor = copy.deepcopy(policy.actor)
        self._mean_actor = copy.deepcopy(policy.actor)
        self._target_critics = copy.deepcopy(self.critics)
        self._flat = {name: Flat(module) for name, module in self._modules().items()}
        # What other processes take part in is not recorded.
        graphs = config.cuda_graphs and device.type == "cuda" and peers.world_size == 1
        self._captured = Captured() if graphs else None
        self._optimizers = {
            name: torch.optim.Adam([self._flat[name].values], lr=lr, fused=True, capturable=graphs)
            for name, lr in (("actor", config.ddpg.actor_lr), ("critics", config.ddpg.critic_lr))
        }

    @torch.no_grad()
    def targets(self, batch: Transitions) -> tuple[torch.Tensor, torch.Tensor]:
        """Bootstrapped targets of the critics.

        Episodes end by time, never by success, so every transition bootstraps.

        Args:
            batch: Transitions.

        Returns:
            Clipped targets, and whether each was clipped. ``(components, batch)`` each
        """
        return self._targets(self._steps(batch, 1), 0)

    @torch.no_grad()
    def _steps(self, block: Transitions, count: int) -> Steps:
        # All at once: only the networks change from one step to the next.
        policy = self.policy
        reward = torch.stack([block.extrinsic, block.intrinsic])
        if not self.config.ddpg.component_critics:
            reward = reward.sum(dim=0, keepdim=True)
        return Steps(
            features=policy.features(block.observation, block.goal, block.source).unflatten(
                0, (count, -1)
            ),
            action=block.action.unflatten(0, (count, -1)),
            next_features=policy.features(
                block.next_observation, block.goal, block.source
            ).unflatten(0, (count, -1)),
            reward=reward.unflatten(1, (count, -1)).transpose(0, 1),
            members=self._subsets(count),
        )

    def _subsets(self, count: int) -> list[list[int]] | None:
        critics, size = self.config.ddpg.critics, self.config.ddpg.target_subset
        if size == critics:
            return None
        drawn = (torch.randperm(critics, generator=self._generator) for _ in range(count))
        return [permutation[:size].tolist() for permutation in drawn]

    @torch.no_grad()
    def _targets(self, steps: Steps, step: int) -> tuple[torch.Tensor, torch.Tensor]:
        features = steps.next_features[step]
        action = self.policy.action(features, self._target_actor)
        members = None if steps.members is None else steps.members[step]
        value = self._target_critics(features, action, members).amin(dim=1)
        raw = steps.reward[step] + self.config.ddpg.gamma * value
        clipped = raw.clamp(self._low, self._high)
        return clipped, clipped != raw

    def update(self, batch: Transitions) -> dict[str, torch.Tensor]:
        """One gradient step of the critics, and of the actor if it is its turn.

        Args:
            batch: Transitions.

        Returns:
            As ``update_block``.
        """
        return self.update_block(batch, 1)

    def update_block(self, block: Transitions, count: int) -> dict[str, torch.Tensor]:
        """Take gradient steps of the critics, and of the actor whenever it is its turn.

        Args:
            block: Transitions, as many for each step, one step's behind the other's; the same for
                all peers, of which each computes on its share.
            count: Steps.

        Returns:
            Values of each step, and of the actor's steps; tensors, so that a GPU need not wait.
            ``(steps,)``
        """
        steps, phase = self._steps(block.share(count, self._peers), count), self._phase
        self._phase = (phase + count) % self.config.ddpg.actor_period
        if self._captured is None or steps.members is not None:
            return self._averaged(self._take(steps, phase))
        tensors = (steps.features, steps.action, steps.next_features, steps.reward)
        return self._captured.run((count, phase), tensors, partial(self._take_captured, phase))

    def _averaged(self, report: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        if self._peers.world_size == 1:
            return report
        values = torch.cat(list(report.values()))
        self._peers.average(values)
        parts = values.split([len(each) for each in report.values()])
        return dict(zip(report, parts, strict=True))

    def _take_captured(self, phase: int, tensors: Tensors) -> dict[str, torch.Tensor]:
        features, action, next_features, reward = tensors
        return self._take(Steps(features, action, next_features, reward), phase)

    def _take(self, steps: Steps, phase: int) -> dict[str, torch.Tensor]:
        reports: dict[str, list[torch.Tensor]] = defaultdict(list)
        period = self.config.ddpg.actor_period
        for step in range(len(steps.features)):
            report = self._update(steps, step, moves_actor=(phase + step) % period == 0)
            for name, value in report.items():
                reports[name].append(value)
        return {name: torch.stack(values) for name, values in reports.items()}

    def _update(self, steps: Steps, step: int, *, moves_actor: bool) -> dict[str, torch.Tensor]:
        target, clipped = self._targets(steps, step)
        features = steps.features[step]
        value = self.critics(features, steps.action[step])
        squared = (value - target.unsqueeze(1)).square()
        # Each network has a loss of its own.
        self._descend("critics", squared.mean(dim=-1).sum())
        report = {
            "critic_loss": squared.detach().mean(),
            "target_clipped": clipped.float().mean(),
        }
        if moves_actor:
            report["q"] = self._update_actor(features)
        self._updates += 1
        if (average := self.config.ddpg.policy_average) is not None:
            # At first the plain mean, so that nothing of the initial weights stays in it.
            share = self._updates.float().reciprocal().clamp(min=average)
            self._flat["mean_actor"].follow(self._flat["actor"], share)
        if self.config.ddpg.target_update == "update":
            self.update_targets()
        return report

    def _update_actor(self, features: torch.Tensor) -> torch.Tensor:
        action = self.policy.action(features)
        value: torch.Tensor = self.critics(features, action).mean(dim=1).sum(dim=0).mean()
        loss = -value + self.config.ddpg.action_l2 * action.square().mean()
        self._descend("actor", loss)
        return value.detach()

    def _descend(self, name: str, loss: torch.Tensor) -> None:
        self._flat[name].clear_gradients()
        self._flat[name].add_gradients(loss)
        self._flat[name].average_gradients(self._peers)
        self._optimizers[name].step()

    def end_cycle(self) -> None:
        """Move the targets, where they are moved once a cycle."""
        if self.config.ddpg.target_update == "cycle":
            self.update_targets()

    def update_targets(self) -> None:
        """Move the target networks towards the online ones by ``tau``."""
        for name in ("actor", "critics"):
            self._flat[f"target_{name}"].follow(self._flat[name], self.config.ddpg.tau)

    def acting_snapshot(self) -> dict[str, Any]:
        """Copy of the policy that acts: the actor, or the running mean of its weights."""
        if self.config.ddpg.policy_average is None:
            return self.policy.snapshot()
        weights = {name: t.clone() for name, t in self._mean_actor.state_dict().items()}
        return self.policy.snapshot() | {"actor": weights}

    def _modules(self) -> dict[str, nn.Module]:
        return {
            "actor": self.policy.actor,
            "critics": self.critics,
            "target_actor": self._target_actor,
            "target_critics": self._target_critics,
            "mean_actor": self._mean_actor,
        }

    def state_dict(self) -> dict[str, Any]:
        """Copy of networks and optimisers, without the policy, which is saved as a snapshot."""
        state: dict[str, Any] = {
            name: module.state_dict() for name, module in self._modules().items() if name != "actor"
        }
        state["updates"] = int(self._updates)
        state["generator"] = self._generator.get_state()
        state["optimizers"] = {name: each.state_dict() for name, each in self._optimizers.items()}
        return copy.deepcopy(state)

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what ``state_dict`` returned."""
        for name, module in self._modules().items():
            if name != "actor":
                module.load_state_dict(state[name])
        self._updates.fill_(state["updates"])
        self._phase = state["updates"] % self.config.ddpg.actor_period
        self._generator.set_state(state["generator"].cpu())
        # Optimisers keep the tensors that they load and then write to them.
        for name, optimizer in self._optimizers.items():
            optimizer.load_state_dict(copy.deepcopy(state["optimizers"][name]))
            for group in optimizer.param_groups:  # the state may come from another device
                group["capturable"] = self._captured is not None
        if self._captured is not None:
            self._captured.forget()
