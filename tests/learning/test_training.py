"""Training runs on the point mass: success, ablations, repeatability, resuming."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.episode import Episode
from iher_robot.learning.learner import Learner
from iher_robot.learning.policy import Policy
from tests.learning.fakes import CPU, same, saved_and_loaded
from tests.learning.point_mass import SHAPES, PointMassGoals, rollout, small_config

ABLATIONS: dict[str, dict[str, dict[str, Any]]] = {
    "iher": {},
    "her": {
        "imagination": {"enabled": False},
        "intrinsic": {"enabled": False},
        "ddpg": {"source_input": False},
    },
    "no-regeneration": {"imagination": {"regenerate": False}},
    "no-intrinsic-reward": {"intrinsic": {"enabled": False}},
    "no-source-input": {"ddpg": {"source_input": False}},
    "one-model": {"dynamics": {"members": 1}},
    "intrinsic-target-range": {"ddpg": {"clip_target": "intrinsic"}},
    "printed-recency": {"dynamics": {"recency_weights": "printed"}},
}


def config(ablation: str = "iher", *, cycles: int = 20) -> LearnerConfig:
    base: dict[str, dict[str, Any]] = {
        "schedule": {"cycles": cycles, "dynamics_steps": 40, "policy_copy_cycles": 5},
        "ddpg": {"gamma": 0.9, "tau": 0.2, "action_l2": 0.1, "actor_lr": 3e-3, "critic_lr": 3e-3},
    }
    for name, values in ABLATIONS[ablation].items():
        base[name] = base.get(name, {}) | values
    return small_config(**base)


def new(config: LearnerConfig, seed: int = 0) -> Learner:
    return Learner(SHAPES, PointMassGoals(), config, seed=seed, device=CPU)


def episodes(epoch: int) -> list[Episode]:
    """Real episodes of one epoch, with random actions."""
    rng = np.random.default_rng(epoch)
    return [rollout(rng) for _ in range(6)]


def train(learner: Learner, first: int, last: int) -> list[dict[str, float]]:
    """Metrics of some epochs, without the speed."""
    metrics = []
    for epoch in range(first, last + 1):
        learner.add_real(episodes(epoch))
        metrics.append(learner.learn())
        del metrics[-1]["updates_per_second"]
    return metrics


def success(policy: Policy) -> float:
    """Share of fresh episodes that end at the goal."""
    rng, goals = np.random.default_rng(999), PointMassGoals()
    ends = [rollout(rng, policy) for _ in range(60)]
    met = [goals.compute_reward(e.observations[-1, :2], e.desired_goal) == 0 for e in ends]
    return float(np.mean(met))


@pytest.mark.parametrize("ablation", ABLATIONS)
def test_it_learns_to_reach_goals_from_sparse_rewards(ablation: str) -> None:
    learner = new(config(ablation))
    assert success(learner.policy) < 0.2
    metrics = train(learner, 1, 3)
    assert success(learner.policy) > 0.6
    imagined = 0 if ablation == "her" else 3 * 20 * 2 * SHAPES.episode_ticks
    assert metrics[-1]["imagined_transitions"] == imagined
    assert all(np.isfinite(value) for row in metrics for value in row.values())


@pytest.mark.parametrize("ablation", ["iher", "her"])
def test_it_learns_as_well_in_bfloat16(ablation: str) -> None:
    learner = new(config(ablation).model_copy(update={"matmul_precision": "bfloat16"}))
    assert learner.policy.matmul_dtype == torch.bfloat16
    train(learner, 1, 3)
    assert success(learner.policy) > 0.6
    assert success(learner.acting_policy(CPU)) > 0.6


@pytest.mark.parametrize("ablation", ["iher", "her"])
def test_resuming_after_an_epoch_equals_no_interruption(ablation: str) -> None:
    whole = new(config(ablation, cycles=7), seed=3)
    train(whole, 1, 2)
    state = saved_and_loaded(whole.state_dict())
    expected = train(whole, 3, 4)

    resumed = new(config(ablation, cycles=7), seed=4)  # the seed has no effect any more
    resumed.load_state_dict(state, [episodes(1), episodes(2)])
    assert train(resumed, 3, 4) == expected
    assert same(resumed.policy.snapshot(), whole.policy.snapshot())
    assert same(resumed.ddpg.state_dict(), whole.ddpg.state_dict())
    assert resumed.imagined_share == whole.imagined_share


def test_no_learner_writes_to_a_state() -> None:
    learner = new(config(cycles=3))
    train(learner, 1, 1)
    state = learner.state_dict()
    kept = saved_and_loaded(state)
    expected = train(learner, 2, 2)
    for _ in range(2):
        resumed = new(config(cycles=3))
        resumed.load_state_dict(state, [episodes(1)])
        assert train(resumed, 2, 2) == expected
    for name in ("policy", "ddpg", "ensemble"):
        assert torch.equal(state["generator"], kept["generator"])
        for part, value in kept[name].items():
            if "optimizer" not in part:
                assert same({part: value}, {part: state[name][part]}), (name, part)


def test_the_seed_decides_every_draw() -> None:
    torch.manual_seed(1)
    one = new(config(cycles=2), seed=5)
    first = train(one, 1, 2)
    torch.manual_seed(2)
    again, other = new(config(cycles=2), seed=5), new(config(cycles=2), seed=6)
    assert train(again, 1, 2) == first
    assert same(again.policy.snapshot(), one.policy.snapshot())
    assert train(other, 1, 2) != first
    assert not same(other.policy.snapshot(), one.policy.snapshot())
