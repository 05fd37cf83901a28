"""A minimal task: a point in a plane that moves by its action.

The observation is (position, velocity, position relative to a fixed mark), the last being
derived; the next position is the position plus 0.05 times the action.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.episode import Episode
from iher_robot.learning.goal_model import Shapes
from iher_robot.learning.policy import Policy

SHAPES = Shapes(obs_dim=6, goal_dim=2, action_dim=2, episode_ticks=12)
STEP = 0.05
THRESHOLD = 0.05
MARK = np.array([0.3, -0.2])


class PointMassGoals:
    """Goal model of the point mass, whose object is the mark."""

    effector_entries = (0, 1)
    hand_actions: tuple[int, ...] = ()

    def __init__(self, threshold: float = THRESHOLD) -> None:
        self.threshold = threshold

    def achieved_goal(self, observation: Any, /) -> Any:
        return observation[..., :2]

    def compute_reward(self, achieved: Any, desired: Any, /) -> Any:
        return -1.0 * (((achieved - desired) ** 2).sum(-1) ** 0.5 > self.threshold)

    def tightened(self, share: float, /) -> PointMassGoals:
        return PointMassGoals(share * self.threshold)

    def complete(self, observation: Any, /) -> Any:
        completed = torch.clone(observation)
        completed[..., 4:6] = observation[..., :2] - torch.as_tensor(
            MARK, dtype=observation.dtype, device=observation.device
        )
        return completed

    def effector_position(self, observation: Any, /) -> Any:
        return observation[..., :2]

    def object_position(self, observation: Any, /) -> Any:
        """Position of the mark, from the derived entries."""
        return observation[..., :2] - observation[..., 4:6]

    def sample_goal(self, rng: np.random.Generator, start: Any, /) -> Any:
        return rng.uniform(-0.3, 0.3, size=(len(start), 2))


def observe(position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    return np.concatenate([position, velocity, position - MARK])


def rollout(rng: np.random.Generator, policy: Policy | None = None) -> Episode:
    """One real episode, with random actions where no policy is given."""
    position = rng.uniform(-0.1, 0.1, size=2)
    goal = PointMassGoals().sample_goal(rng, position[None])[0]
    observations, actions = [observe(position, np.zeros(2))], []
    for _ in range(SHAPES.episode_ticks):
        action = rng.uniform(-1, 1, size=2)
        if policy is not None:
            action = policy.act(
                torch.as_tensor(observations[-1], dtype=torch.float32)[None],
                torch.as_tensor(goal, dtype=torch.float32)[None],
                torch.zeros(1, dtype=torch.long),
            )[0].numpy()
        position = position + STEP * action
        observations.append(observe(position, STEP * action))
        actions.append(action)
    return Episode(
        observations=np.array(observations),
        actions=np.array(actions),
        requested_actions=np.array(actions),
        valid=np.ones(len(actions), dtype=bool),
        desired_goal=goal,
    )


def small_config(**sections: dict[str, Any]) -> LearnerConfig:
    """Settings that learn the point mass in seconds."""
    base: dict[str, dict[str, Any]] = {
        "schedule": {
            "workers": 1,
            "real_rollouts": 4,
            "imaginary_rollouts": 2,
            "cycles": 5,
            "batches": 10,
            "dynamics_steps": 60,
            "policy_copy_cycles": 2,
        },
        "ddpg": {"hidden": (64, 64), "batch_size": 128},
        "dynamics": {"members": 3, "hidden": (64, 64), "batch_size": 64},
        "replay": {"capacity": 12_000},
    }
    for name, values in sections.items():
        base.setdefault(name, {}).update(values)
    # The same on every machine that runs the tests.
    return LearnerConfig.model_validate(base | {"matmul_precision": "highest"})
