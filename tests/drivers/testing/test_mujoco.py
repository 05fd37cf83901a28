"""The simulated Fetch robot, in both actuations."""

from __future__ import annotations

from drivers import RobotDriver
from drivers.mujoco import FetchRobot, MujocoDriver
from iher_robot.testing import DriverContract


class TestFetchDraggedByAMocapBody(DriverContract):
    def make_driver(self) -> RobotDriver:
        return MujocoDriver("push", FetchRobot(actuation="mocap"))


class TestFetchMovedByItsJoints(DriverContract):
    overshoot = 0.02  # measured: 0.002, and the same in m/s and rad/s for its joints
    speed_error = 0.01

    def make_driver(self) -> RobotDriver:
        return MujocoDriver("push", FetchRobot(actuation="joint"))
