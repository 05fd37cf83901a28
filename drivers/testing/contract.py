"""The conformance suite as one class of tests."""

from __future__ import annotations

from drivers.testing.commands import CommandTests
from drivers.testing.excess import ExcessTests
from drivers.testing.following import FollowingTests
from drivers.testing.lifecycle import LifecycleTests
from drivers.testing.resets import ResetTests
from drivers.testing.states import StateTests
from drivers.testing.stopping import StopTests
from drivers.testing.ticks import TickTests


class DriverContract(
    LifecycleTests,
    StopTests,
    TickTests,
    StateTests,
    CommandTests,
    FollowingTests,
    ExcessTests,
    ResetTests,
):
    """Tests of the contract of `RobotDriver`, which every driver must pass unchanged.

    A subclass among a driver's tests makes the driver, and may declare its properties
    (`real_time`, `several`, tolerances)::

        class TestMyRobot(DriverContract):
            def make_driver(self) -> RobotDriver:
                return MyRobot()

    Tests that send commands run once for each kind that the driver's spec declares. The suite
    moves the robot far and at full speed: clear the workspace of a real one.
    """
