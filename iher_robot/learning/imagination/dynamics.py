"""Ensemble of one-step dynamics models (paper, section III.B and appendix)."""

from __future__ import annotations

import copy
import math
from functools import partial
from typing import Any

import torch
from torch import nn

from iher_robot.learning.config import DynamicsConfig
from iher_robot.learning.goal_model import Shapes
from iher_robot.learning.networks.data_parallel import ALONE, Peers, local_rows
from iher_robot.learning.networks.flat_parameters import FlatParameters
from iher_robot.learning.networks.mlp import forward, in_blocks, mlp
from iher_robot.learning.networks.normalizer import FittedNormalizer
from iher_robot.learning.replay import EpisodeReplay
from iher_robot.learning.symmetry import Symmetry, choose_maps

DIVERGED = "the models diverged; lower learner.dynamics.lr or raise learner.dynamics.std_floor"


def recency_weights(epoch: int, config: DynamicsConfig) -> torch.Tensor:
    """Sampling weight of a transition by the epoch in which it was collected.

    Args:
        epoch: The current epoch E, from 1.
        config: Bias b, and which form.

    Returns:
        1 + (b - 1) i / E, or as printed in the paper i / E (b - 1), for i = 0..E. ``(E + 1,)``
    """
    share = torch.arange(epoch + 1, dtype=torch.float64) / epoch
    weights = share * (config.recency_bias - 1.0)
    return weights if config.recency_weights == "printed" else 1.0 + weights


class DynamicsEnsemble:
    """Networks, each of which predicts the change of the observation in one control tick.

    Members differ in their initial weights and in their batches. Inputs and targets are normalised
    with statistics of the real data, which only ``fit_normalizers`` changes.

    Args:
        shapes: Sizes of the arrays.
        config: Size, training and normalisation.
        generator: Draws the initial weights, on the CPU.
        device: Where the models compute.
        symmetry: Maps whose images of real transitions are learned from; None for none.
        matmul_dtype: Type of the matrix products between hidden layers.
        peers: Learners with which it shares every batch.
    """

    def __init__(
        self,
        shapes: Shapes,
        config: DynamicsConfig,
        *,
        generator: torch.Generator,
        device: torch.device,
        symmetry: Symmetry | None = None,
        matmul_dtype: torch.dtype = torch.float32,
        peers: Peers = ALONE,
    ) -> None:
        self.config = config
        self._peers = peers
        self._seen = torch.ones(shapes.obs_dim + shapes.action_dim, device=device)
        if config.inputs == "relative":
            self._seen[list(shapes.shifted_entries)] = 0.0
        self._symmetry = symmetry
        inputs = shapes.obs_dim + shapes.action_dim
        self._matmul_dtype = matmul_dtype
        self.members = nn.ModuleList(
            mlp(inputs, config.hidden, shapes.obs_dim, generator) for _ in range(config.members)
        ).to(device)
        self._flat = FlatParameters(self.members)
        self.input_normalizer = FittedNormalizer(inputs, std_floor=config.std_floor, device=device)
        self.delta_normalizer = FittedNormalizer(
            shapes.obs_dim, std_floor=config.std_floor, device=device
        )
        # Range of the real observations, for imagination.
        self.obs_low = torch.full((shapes.obs_dim,), -torch.inf, device=device)
        self.obs_high = torch.full((shapes.obs_dim,), torch.inf, device=device)
        self._optimizer = torch.optim.Adam([self._flat.values], lr=config.lr, fused=True)

    def fit_normalizers(self, real: EpisodeReplay, generator: torch.Generator) -> None:
        """Fit the statistics to every stored real transition, or to an image of each.

        Args:
            real: Real transitions.
            generator: Draws the images.
        """
        observation, action, following = self._steps(real, *real.all_indices(), generator)
        self.input_normalizer.fit(torch.cat([observation, action], dim=-1))
        self.delta_normalizer.fit(following - observation)
        self.obs_low = torch.minimum(observation.amin(0), following.amin(0))
        self.obs_high = torch.maximum(observation.amax(0), following.amax(0))

    def train(
        self, real: EpisodeReplay, steps: int, *, batch_size: int, generator: torch.Generator
    ) -> float:
        """Take gradient steps on each member, with separate batches.

        Args:
            real: Real transitions.
            steps: Gradient steps.
            batch_size: Transitions a step and member.
            generator: Draws the batches.

        Returns:
            Mean squared error of the last step in normalised units, averaged over members and
            dimensions.

        Raises:
            FloatingPointError: The error is not finite.
        """
        epoch = max(1, real.newest_epoch)
        weights = recency_weights(epoch, self.config).to(self.obs_low.device)
        members = len(self.members)
        loss = torch.zeros((), device=self.obs_low.device)
        for _ in range(steps):
            # Separate rows for each member: members trained on the same would hardly disagree.
            episode, tick = real.sample_indices(members * batch_size, generator, weights)
            observation, action, following = (
                local_rows(each, members, self._peers)
                for each in self._steps(real, episode, tick, generator)
            )
            target = self.delta_normalizer.normalize(following - observation)
            inputs = self._inputs(observation, action)
            loss.zero_()
            self._flat.clear_gradients()
            for member, rows, wanted in zip(
                self.members, inputs.chunk(members), target.chunk(members), strict=True
            ):
                squared = (self._forward(member, rows) - wanted).square()
                self._flat.add_gradients(squared.sum(-1).mean())
                loss += squared.detach().mean()
            self._flat.average_gradients(self._peers)
            self._optimizer.step()
        self._peers.average(loss)
        mean_loss = float(loss) / members
        if not math.isfinite(mean_loss):
            raise FloatingPointError(f"the dynamics models' error is {mean_loss}: {DIVERGED}")
        return mean_loss

    def _steps(
        self,
        real: EpisodeReplay,
        episode: torch.Tensor,
        tick: torch.Tensor,
        generator: torch.Generator,
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        observation, action, following = real.sample_steps(episode, tick, generator)
        if self._symmetry is None:
            return observation, action, following
        maps = choose_maps(self._symmetry, observation, following, generator)
        return maps.observation(observation), maps.action(action), maps.observation(following)

    def _inputs(self, observation: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        inputs = torch.cat([observation, action], dim=-1)
        return self.input_normalizer.normalize(inputs) * self._seen

    @torch.no_grad()
    def predict(self, observation: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """Every member's prediction of the normalised change.

        Args:
            observation: ``(batch, obs_dim)``
            action: ``(batch, action_dim)``

        Returns:
            ``(members, batch, obs_dim)``
        """
        inputs = self._inputs(observation, action)
        return torch.stack(
            [in_blocks(partial(self._forward, member), inputs) for member in self.members]
        )

    def _forward(self, member: nn.Module, inputs: torch.Tensor) -> torch.Tensor:
        assert isinstance(member, nn.Sequential)
        return forward(member, inputs, self._matmul_dtype)

    def next_observation(
        self, observation: torch.Tensor, normalized_delta: torch.Tensor
    ) -> torch.Tensor:
        """Observation after a predicted change. ``(batch, obs_dim)``"""
        return observation + self.delta_normalizer.denormalize(normalized_delta)

    def state_dict(self) -> dict[str, Any]:
        """Copy of weights, optimiser state and statistics."""
        return {
            "members": copy.deepcopy(self.members.state_dict()),
            "optimizer": copy.deepcopy(self._optimizer.state_dict()),
            "input_normalizer": self.input_normalizer.state_dict(),
            "delta_normalizer": self.delta_normalizer.state_dict(),
            "obs_low": self.obs_low.clone(),
            "obs_high": self.obs_high.clone(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what ``state_dict`` returned."""
        self.members.load_state_dict(state["members"])
        self._optimizer.load_state_dict(copy.deepcopy(state["optimizer"]))
        self.input_normalizer.load_state_dict(state["input_normalizer"])
        self.delta_normalizer.load_state_dict(state["delta_normalizer"])
        self.obs_low = state["obs_low"].to(self.obs_low.device)
        self.obs_high = state["obs_high"].to(self.obs_high.device)
