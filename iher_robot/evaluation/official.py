"""The official environments: gymnasium-robotics' own Fetch tasks, as an episode needs them."""

from __future__ import annotations

import io
from contextlib import redirect_stderr
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from iher_robot.env.goal_env import Observation

OFFICIAL_IDS = {
    "reach": "FetchReach-v4",
    "push": "FetchPush-v4",
    "pick_and_place": "FetchPickAndPlace-v4",
    "slide": "FetchSlide-v4",
}
"""Environment id of each task."""


class OfficialEnv(
    gym.Wrapper[Observation, NDArray[np.floating], Observation, NDArray[np.floating]]
):
    """An official environment; its simulated robot is never armed, so there is none to hold.

    Args:
        name: Environment id.
        render_mode: ``"rgb_array"`` or None.
    """

    def __init__(self, name: str, render_mode: str | None = None) -> None:
        # Importing the package prints notices about environments that are not ours.
        with redirect_stderr(io.StringIO()):
            import gymnasium_robotics
        gym.register_envs(gymnasium_robotics)
        env: gym.Env[Any, Any] = gym.make(name, render_mode=render_mode)
        super().__init__(env)

    def hold(self, after: BaseException | None = None) -> None:
        """Do nothing."""
