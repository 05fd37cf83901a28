"""Settings: defaults are the paper's values for Push; invalid ones are refused."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from iher_robot.learning.config import DynamicsConfig, LearnerConfig

PAPER = {
    "schedule.workers": 8,
    "schedule.real_rollouts": 32,
    "schedule.imaginary_rollouts": 2,
    "schedule.cycles": 250,
    "schedule.batches": 40,
    "schedule.dynamics_steps": 1250,
    "schedule.first_epoch_dynamics_factor": 5,
    "schedule.policy_copy_cycles": 50,
    "schedule.real_episodes": 8 * 32,
    "schedule.imaginary_episodes": 8 * 2,
    "replay.capacity": 1_000_000,
    "replay.future_fraction": 0.8,
    "dynamics.members": 5,
    "dynamics.hidden": (512, 512),
    "dynamics.lr": 1e-3,
    "dynamics.batch_size": 512,
    "dynamics.recency_bias": 2.0,
    "intrinsic.scale": 0.5,
    "intrinsic.clip": 0.8,
    "exploration.source_flip": 0.1,
}


@pytest.mark.parametrize("key", PAPER)
def test_defaults_are_the_papers(key: str) -> None:
    value: Any = LearnerConfig()
    for part in key.split("."):
        value = getattr(value, part)
    assert value == PAPER[key]


def test_every_part_of_the_method_is_on_by_default() -> None:
    config = LearnerConfig()
    assert config.imagination.enabled
    assert config.imagination.regenerate
    assert config.intrinsic.enabled
    assert config.ddpg.source_input


def test_a_bias_that_gives_every_transition_weight_zero_is_refused() -> None:
    assert DynamicsConfig(recency_bias=1.0).recency_bias == 1.0
    with pytest.raises(ValidationError, match="weight 0"):
        DynamicsConfig(recency_bias=1.0, recency_weights="printed")


def test_unknown_keys_and_later_changes_are_refused() -> None:
    with pytest.raises(ValidationError, match="extra"):
        LearnerConfig.model_validate({"ddpg": {"gama": 0.9}})
    with pytest.raises(ValidationError, match="frozen"):
        LearnerConfig().ddpg.gamma = 0.5  # type: ignore[misc]
