"""Fakes: episodes, models, policies and symmetries with known outputs."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from iher_robot.learning.config import DynamicsConfig, ExplorationConfig, LearnerConfig
from iher_robot.learning.episode import Episode
from iher_robot.learning.goal_model import REAL
from iher_robot.learning.imagination.dynamics import DynamicsEnsemble
from iher_robot.learning.policy import Policy
from iher_robot.learning.replay import EpisodeReplay
from tests.learning.point_mass import SHAPES, STEP, small_config

CPU = torch.device("cpu")
OBS, ACTION = SHAPES.obs_dim, SHAPES.action_dim
NO_NOISE = ExplorationConfig(noise_std=0.0, random_fraction=0.0, source_flip=0.0)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def marked_episode(number: int, length: int) -> Episode:
    """An episode that carries (its number, the tick) in observations and actions.

    The achieved goal of the point mass is then (number, tick); the desired goal is (-1, number).
    """
    ticks = np.arange(length + 1)
    observations = np.zeros((length + 1, OBS))
    observations[:, 0], observations[:, 1] = number, ticks
    return Episode(
        observations=observations,
        actions=observations[:-1, :2].copy(),
        requested_actions=observations[:-1, :2].copy(),
        valid=np.ones(length, dtype=bool),
        desired_goal=np.array([-1.0, number]),
    )


def store(
    replay: EpisodeReplay, episodes: Sequence[Episode], epoch: int = 1, weight: float = 1.0
) -> EpisodeReplay:
    """Add episodes one by one, as the learner does."""
    for episode in episodes:
        replay.add(
            torch.as_tensor(episode.observations)[None],
            torch.as_tensor(episode.actions)[None],
            torch.as_tensor(episode.desired_goal)[None],
            epoch=epoch,
            weight=weight,
        )
    return replay


def replay_of(
    episodes: Sequence[Episode] = (), *, capacity: int = 12_000, source: int = REAL
) -> EpisodeReplay:
    replay = EpisodeReplay(SHAPES, capacity=capacity, source=source, device=CPU)
    return store(replay, episodes)


def stored(replay: EpisodeReplay) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Observation, action and next observation of every stored transition."""
    return replay.steps(*replay.all_indices())


def linear_ensemble(
    biases: Sequence[Sequence[float]], weight: torch.Tensor | None = None
) -> DynamicsEnsemble:
    """Members that predict weight @ (observation, action) + bias, in physical units.

    Args:
        biases: One a member. ``(members, obs_dim)``
        weight: Shared by all members; zero if None. ``(obs_dim, obs_dim + action_dim)``
    """
    config = DynamicsConfig(members=len(biases), hidden=())
    ensemble = DynamicsEnsemble(SHAPES, config, generator=generator(), device=CPU)
    state = ensemble.state_dict()
    for index, bias in enumerate(biases):
        state["members"][f"{index}.0.weight"] = (
            torch.zeros(OBS, OBS + ACTION) if weight is None else weight
        )
        state["members"][f"{index}.0.bias"] = torch.tensor(bias)
    ensemble.load_state_dict(state)
    return ensemble


def drifting_ensemble(*drifts: float) -> DynamicsEnsemble:
    """Members that only move entry 2 of the observation, each by its own drift a tick."""
    return linear_ensemble([[0.0, 0.0, drift, 0.0, 0.0, 0.0] for drift in drifts])


def perfect_ensemble(members: int = 3) -> DynamicsEnsemble:
    """The point mass itself: the velocity becomes, and the position moves by, STEP * action."""
    weight = torch.zeros(OBS, OBS + ACTION)
    for axis in range(2):
        for entry in (axis, 2 + axis, 4 + axis):
            weight[entry, OBS + axis] = STEP
        weight[2 + axis, 2 + axis] = -1.0
    return linear_ensemble([[0.0] * OBS] * members, weight)


def linear_policy(
    bias: Sequence[float] = (0.0, 0.0),
    *,
    goal_gain: float = 0.0,
    real_bias: float | None = None,
    cls: type[Policy] = Policy,
) -> Policy:
    """tanh(goal_gain * (goal - position) + bias, and + real_bias for the real source)."""
    policy = cls(
        SHAPES,
        hidden=(),
        source_input=real_bias is not None,
        normalizer_clip=1e9,
        normalizer_std_floor=0.01,
        generator=generator(),
        device=CPU,
    )
    snapshot = policy.snapshot()
    weight = torch.zeros(ACTION, policy.input_dim)
    for axis in range(2):
        weight[axis, axis], weight[axis, OBS + axis] = -goal_gain, goal_gain
    if real_bias is not None:
        weight[:, -1] = real_bias
    snapshot["actor"] = {"0.weight": weight, "0.bias": torch.tensor(bias)}
    policy.load_snapshot(snapshot)
    return policy


def quiet_config(**sections: dict[str, Any]) -> LearnerConfig:
    """The point mass's settings without exploration, so that actions identify the policy."""
    noise = NO_NOISE.model_dump() | sections.pop("exploration", {})
    return small_config(exploration=noise, **sections)


def deviation(counts: torch.Tensor, expected: torch.Tensor) -> float:
    """Standard deviations by which Pearson's chi-square exceeds its mean.

    Args:
        counts: Occurrences of each outcome.
        expected: Their probabilities, of any scale.
    """
    counts, expected = counts.double().flatten(), expected.double().flatten()
    expected = expected / expected.sum() * counts.sum()
    freedom = len(counts) - 1
    statistic = ((counts - expected).square() / expected).sum()
    return float((statistic - freedom) / (2 * freedom) ** 0.5)


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether two nested states are identical to the bit."""
    if one.keys() != other.keys():
        return False
    for name, value in one.items():
        if isinstance(value, dict):
            if not same(value, other[name]):
                return False
        elif isinstance(value, torch.Tensor):
            if not torch.equal(value, other[name]):
                return False
        elif value != other[name]:
            return False
    return True


def saved_and_loaded(state: dict[str, Any]) -> dict[str, Any]:
    file = io.BytesIO()
    torch.save(state, file)
    file.seek(0)
    loaded: dict[str, Any] = torch.load(file, weights_only=True)
    return loaded


@dataclass(frozen=True)
class FarAway:
    """A map with recognisable images: positions moved by ``by``, the action reversed.

    Attributes:
        by: What is added to positions. ``(batch, 1)``
    """

    by: torch.Tensor

    def observation(self, observation: torch.Tensor, /) -> torch.Tensor:
        image = observation.clone()
        image[:, :2] += self.by
        return image

    def action(self, action: torch.Tensor, /) -> torch.Tensor:
        return -action

    def goal(self, goal: torch.Tensor, /) -> torch.Tensor:
        return goal + self.by


class FarAwaySymmetry:
    """Moves each row by 100 to 200, depending on its random number."""

    draws = 1

    def choose(self, uniform: torch.Tensor, start: torch.Tensor, end: torch.Tensor, /) -> FarAway:
        assert uniform.shape == (len(start), 1)
        assert start.shape == end.shape
        return FarAway(100.0 + 100.0 * uniform)
