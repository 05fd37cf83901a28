"""Learners with very short epochs, which test what an epoch does and not what it learns."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.episode import Episode
from iher_robot.learning.learner import Learner
from iher_robot.learning.replay import EpisodeReplay
from tests.learning.fakes import CPU, stored
from tests.learning.point_mass import SHAPES, PointMassGoals, rollout, small_config

HER: dict[str, Any] = {
    "imagination": {"enabled": False},
    "intrinsic": {"enabled": False},
    "ddpg": {"source_input": False},
}


def quick(**sections: dict[str, Any]) -> LearnerConfig:
    """Settings with a few updates an epoch."""
    base: dict[str, dict[str, Any]] = {
        "schedule": {"cycles": 4, "batches": 3, "dynamics_steps": 6, "policy_copy_cycles": 2},
        "ddpg": {"hidden": (16, 16), "batch_size": 50},
        "dynamics": {"hidden": (32, 32)},
    }
    for name, values in sections.items():
        base[name] = base.get(name, {}) | values
    return small_config(**base)


def new(config: LearnerConfig, seed: int = 0, **declared: Any) -> Learner:
    return Learner(SHAPES, PointMassGoals(), config, seed=seed, device=CPU, **declared)


def real(epoch: int, count: int = 4) -> list[Episode]:
    rng = np.random.default_rng(epoch)
    return [rollout(rng) for _ in range(count)]


def after(epochs: int, config: LearnerConfig) -> Learner:
    learner = new(config)
    for epoch in range(1, epochs + 1):
        learner.add_real(real(epoch))
        learner.learn()
    return learner


def rows(replay: EpisodeReplay) -> set[tuple[float, ...]]:
    """Every stored transition, hashable."""
    return {tuple(row) for row in torch.cat(stored(replay), dim=-1).tolist()}
