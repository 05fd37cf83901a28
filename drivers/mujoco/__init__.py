"""Driver of the simulated Fetch robot, on MuJoCo."""

from __future__ import annotations

from drivers.mujoco.driver import MujocoDriver, make_fetch
from drivers.mujoco.robot import FetchRobot
from drivers.mujoco.scene import SCENES, FetchScene

__all__ = ["SCENES", "FetchRobot", "FetchScene", "MujocoDriver", "make_fetch"]
