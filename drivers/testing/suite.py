"""What the tests of the driver contract share."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import ClassVar, TypeVar

import numpy as np
import pytest

from drivers import AppliedCommand, ResetOutcome, ResetRequest, RobotDriver, RobotState
from drivers.testing.command_samples import CommandSamples, EndEffectorSamples, JointSamples

Error = TypeVar("Error", bound=Exception)


class ContractSuite(ABC):
    """A fresh driver for each test, and the tolerances that its author declares."""

    real_time: ClassVar[bool] = False
    """Whether ticks pass by a clock of the world, so that their length varies."""
    several: ClassVar[bool] = True
    """Whether two drivers may exist at once; one physical robot has one."""
    places_objects: ClassVar[bool] = True
    """Whether a reset puts objects in place without a person."""
    settling_ticks: ClassVar[int] = 25
    """Held ticks after which the robot is at rest, however it moved before."""
    rest_speed: ClassVar[float] = 5e-3
    """Speed of the end effector below which the robot is at rest, m/s."""
    home_tolerance: ClassVar[float] = 0.01
    """Greatest distance from the declared home after a reset, m and rad."""
    object_tolerance: ClassVar[float] = 0.01
    """Greatest distance of an object from where a reset was asked to put it, m."""
    overshoot: ClassVar[float] = 0.1
    """Share by which a measured speed may exceed its limit, since a motor follows its target
    with an error. What is reported as applied may not exceed a limit at all."""
    speed_error: ClassVar[float] = 0.05
    """By how much the measured speed of a joint may exceed its limit besides, m/s and rad/s:
    it is measured with an error."""
    position_error: ClassVar[float] = 0.01
    """By how much a measured position may exceed its limit, m and rad."""
    kinds: ClassVar[Sequence[str]] = ()
    """Kinds of command that the robot declares; by default a driver is made to ask it."""
    sample_types: ClassVar[Sequence[type[CommandSamples]]] = (EndEffectorSamples, JointSamples)
    """Makers of commands, one for each kind that the robot may declare."""

    @abstractmethod
    def make_driver(self) -> RobotDriver:
        """Return a new driver, not open and without a latched fault."""

    @pytest.fixture
    def driver(self) -> Iterator[RobotDriver]:
        """Give a test its driver, and end it held and disarmed."""
        made = self.make_driver()
        yield made
        _retire(made)

    @pytest.fixture
    def other_driver(self) -> Iterator[RobotDriver]:
        """Give a test a second driver beside the first."""
        if not self.several:
            pytest.skip("this robot has one driver at a time")
        made = self.make_driver()
        yield made
        _retire(made)

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Run each test that takes a `kind` with every kind of command the spec declares."""
        if "kind" in metafunc.fixturenames:
            metafunc.parametrize("kind", _declared_kinds(type(self)))

    def samples(self, driver: RobotDriver, kind: str) -> CommandSamples:
        """Return the maker of commands of a kind."""
        for sample_type in self.sample_types:
            if sample_type.kind == kind:
                return sample_type(driver.spec)
        pytest.fail(
            f"the suite knows no commands of kind {kind!r}; subclass CommandSamples for it and "
            "add it to sample_types"
        )

    def start(self, driver: RobotDriver) -> RobotState:
        """Open, reset and arm; return the first state."""
        driver.open()
        self.reset(driver)
        driver.arm()
        return driver.read()

    def reset(self, driver: RobotDriver, request: ResetRequest | None = None) -> None:
        """Reset, and demand that it is done."""
        result = driver.reset(ResetRequest() if request is None else request)
        assert result.outcome is ResetOutcome.DONE, (
            f"the suite needs a robot that resets by itself; reset answered {result}"
        )

    def tick(self, driver: RobotDriver, samples: CommandSamples, sign: float = 1.0) -> RobotState:
        """Run one tick with a small command; return the state at its end."""
        acceptance = driver.command(samples.small(driver.read(), sign))
        assert acceptance.accepted, (
            f"a valid command that answers the newest state must be accepted, got {acceptance}"
        )
        driver.advance()
        return driver.read()

    def applied_at_once(self, state: RobotState) -> AppliedCommand | None:
        """Return what was applied, if it was in the tick after what it answers; else None.

        In real time a test may miss ticks. In a simulation no tick passes unasked.

        Args:
            state: The newest one, after a command that was accepted.
        """
        applied = state.applied
        assert applied is not None, "a command that was accepted is reported as applied"
        answered = applied.command.answers
        assert answered < applied.tick <= state.seq, (
            f"`applied.tick` is {applied.tick}, not after the state that the command answers, "
            f"{answered}, or not yet over in state {state.seq}"
        )
        at_once = applied.tick == state.seq == answered + 1
        assert at_once or self.real_time, (
            f"`applied.tick` is the state that ends the tick: the command answers {answered}, "
            f"`applied.tick` is {applied.tick}, and the state after it is {state.seq}"
        )
        return applied if at_once else None

    def hold(self, driver: RobotDriver, ticks: int) -> RobotState:
        """Run ticks without a command; return the last state."""
        for _ in range(ticks):
            driver.advance()
        return driver.read()

    def assert_at_rest(self, driver: RobotDriver, demand: str) -> None:
        """Demand that the end effector stays where it is over the next ticks.

        Args:
            driver: The robot.
            demand: What the contract says, for the message.
        """
        before, ticks = driver.read(), 5
        after = self.hold(driver, ticks)
        way = float(np.linalg.norm(after.ee_pos - before.ee_pos))
        allowed = self.rest_speed * ticks * driver.spec.control_period_s
        assert way <= allowed, (
            f"{demand}; the end effector went {way:.2g} m in {ticks} ticks, allowed: {allowed:.2g}"
        )


def must_raise(error: type[Error], call: Callable[[], object], demand: str) -> Error:
    """Demand that a call raises an error.

    Args:
        error: Its type.
        call: What raises it.
        demand: What the contract says, for the message.

    Returns:
        The error.
    """
    try:
        call()
    except error as raised:
        return raised
    raise AssertionError(f"{demand}; it must raise {error.__name__}, and nothing was raised")


def _retire(driver: RobotDriver) -> None:
    driver.close()
    if driver.fault is not None:  # a stop of one test would outlive it on a robot with a host
        driver.clear_fault(driver.fault.name)


@functools.cache
def _declared_kinds(suite: type[ContractSuite]) -> tuple[str, ...]:
    return tuple(suite.kinds) or suite().make_driver().spec.command_kinds
