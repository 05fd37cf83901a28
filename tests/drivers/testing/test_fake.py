"""The fault-injecting robot of these tests, in simulated and in real time."""

from __future__ import annotations

import dataclasses

from drivers import MonotonicClock, RobotDriver
from iher_robot.testing import DriverContract
from tests.drivers.fake_robot import FakeRobot, fake_spec


class TestFakeRobot(DriverContract):
    def make_driver(self) -> RobotDriver:
        return FakeRobot()


class TestFakeRobotInRealTime(DriverContract):
    real_time = True
    settling_ticks = 2

    def make_driver(self) -> RobotDriver:
        # Short ticks spare time; a long watchdog bears a machine that is busy with other tests.
        limits = dataclasses.replace(fake_spec().limits, watchdog_s=0.5)
        spec = dataclasses.replace(fake_spec(), control_period_s=0.004, limits=limits)
        return FakeRobot(spec, MonotonicClock())
