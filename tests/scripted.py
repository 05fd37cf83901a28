"""Scripted policies, which show that the tasks can be solved."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from iher_robot.env.goal_env import GoalRobotEnv

Array = NDArray[np.float64]
Policy = Callable[[Array, Array], Array]

_GAIN = 12.0  # action per metre of distance
_ABOVE_M = 0.07


class Push:
    """Moves around the object, down behind it, and pushes it to the goal."""

    def __call__(self, obs: Array, goal: Array) -> Array:
        gripper, block = obs[:3], obs[3:6]
        way = goal[:2] - block[:2]
        distance = float(np.linalg.norm(way))
        action = np.zeros(4)
        if distance < 0.01:
            return action
        forward = way / distance
        from_block = gripper[:2] - block[:2]
        along = float(from_block @ forward)
        aside = from_block - along * forward
        behind = block[:2] - 0.06 * forward
        low = block[2] + 0.005
        if along > -0.04 or np.linalg.norm(aside) > 0.012:
            if np.linalg.norm(gripper[:2] - behind) > 0.02:
                action[2] = block[2] + _ABOVE_M - gripper[2]
                if gripper[2] > block[2] + 0.055 or np.linalg.norm(from_block) > 0.09:
                    action[:2] = behind - gripper[:2]
            else:
                action[:3] = [*(behind - gripper[:2]), low - gripper[2]]
        elif gripper[2] > low + 0.015:
            action[:3] = [*(behind - gripper[:2]), low - gripper[2]]
        else:
            reach = 0.8 * distance if distance < 0.03 else min(distance + 0.02, 0.06)
            action[:3] = [*(reach * forward - aside), low - gripper[2]]
        return _GAIN * action


class PickAndPlace:
    """Opens above the object, moves down, closes, and carries it to the goal."""

    def __init__(self) -> None:
        self._down = False
        self._closing = 0
        self._gripped = 0
        self._held = False

    def __call__(self, obs: Array, goal: Array) -> Array:
        gripper, block, finger = obs[:3], obs[3:6], float(obs[9:11].mean())
        if self._held:
            return np.append(_GAIN * (goal - block), -1.0)
        near = float(np.linalg.norm((block - gripper)[:2])) < 0.01
        self._down |= near and finger > 0.034  # not before it is open: the gripper is slow
        target = block + np.array([0.0, 0.0, -0.003 if self._down else 0.06])
        off = np.abs(block - gripper)
        if self._down and off[2] < 0.012 and np.linalg.norm(off[:2]) < 0.012:
            self._closing += 1
        self._gripped += self._closing > 3 and finger < 0.026
        self._held = self._gripped > 3  # enough ticks for the fingers to press
        return np.append(_GAIN * (target - gripper), -1.0 if self._closing else 1.0)


def success_rate(env: GoalRobotEnv, make_policy: Callable[[], Policy], episodes: int) -> float:
    """Share of episodes whose last step meets the goal."""
    successes = 0.0
    for seed in range(1000, 1000 + episodes):
        observation, _ = env.reset(seed=seed)
        policy, info = make_policy(), {"is_success": 0.0}
        for _ in range(env.episode_ticks):
            action = policy(observation["observation"], observation["desired_goal"])
            observation, _, _, _, info = env.step(action)
        successes += info["is_success"]
    return successes / episodes
