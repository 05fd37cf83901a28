"""Registration of the environments with Gymnasium."""

from __future__ import annotations

import gymnasium as gym

ENV_IDS = {
    "iher_robot/Reach-v0": "reach",
    "iher_robot/Push-v0": "push",
    "iher_robot/PickAndPlace-v0": "pick_and_place",
    "iher_robot/Slide-v0": "slide",
}
"""Task of each id."""

_EPISODE_TICKS = 50


def register_envs() -> None:
    """Register the simulated tasks with Gymnasium; idempotent.

    Drivers and tasks are imported only when an environment is made.
    """
    for env_id, task_name in ENV_IDS.items():
        if env_id not in gym.registry:
            gym.register(
                id=env_id,
                entry_point="iher_robot.env:make_env",
                max_episode_steps=_EPISODE_TICKS,
                kwargs={"task_name": task_name},
            )
