"""The simulated Fetch robot, on MuJoCo."""

from __future__ import annotations

from drivers.mujoco.driver import MujocoDriver
from drivers.mujoco.scene import SCENES, FetchScene

__all__ = ["SCENES", "FetchScene", "MujocoDriver"]
