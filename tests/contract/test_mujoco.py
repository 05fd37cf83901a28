"""The simulated Fetch robot, in both actuations."""

from __future__ import annotations

from drivers import RobotDriver
from drivers.mujoco import FetchRobot, MujocoDriver
from iher_robot.testing import DriverContract


class TestFetchDraggedByAMocapBody(DriverContract):
    def make_driver(self) -> RobotDriver:
        return MujocoDriver("push", FetchRobot(actuation="mocap"))


class TestFetchMovedByItsJoints(DriverContract):
    # Thrown to and fro at full acceleration its gripper was measured at 1.12 m/s, told 1.0.
    overshoot = 0.15

    def make_driver(self) -> RobotDriver:
        return MujocoDriver("push", FetchRobot(actuation="joint"))
