"""Base class of the tests of the driver contract: fixtures, tolerances, assertions."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import ClassVar, TypeVar

import numpy as np
import pytest

from drivers import AppliedCommand, Command, ResetOutcome, ResetRequest, RobotDriver, RobotState
from drivers.testing.command_samples import CommandSamples, EndEffectorSamples, JointSamples

Error = TypeVar("Error", bound=Exception)


class ContractSuite(ABC):
    """Makes a new driver for each test; holds the properties and tolerances of the robot."""

    real_time: ClassVar[bool] = False
    """Whether ticks take real time, so that their length varies and some may be missed."""
    several: ClassVar[bool] = True
    """Whether two drivers may exist at once; a physical robot has one."""
    places_objects: ClassVar[bool] = True
    """Whether a reset puts objects in place without a person."""
    settling_ticks: ClassVar[int] = 25
    """Held ticks after which the robot is at rest, from any motion."""
    rest_speed: ClassVar[float] = 5e-3
    """Speed of the end effector below which the robot is at rest, m/s."""
    home_tolerance: ClassVar[float] = 0.01
    """Greatest distance from the declared home after a reset, m and rad."""
    object_tolerance: ClassVar[float] = 0.01
    """Greatest distance of an object from the place requested of a reset, m."""
    overshoot: ClassVar[float] = 0.1
    """Share by which a measured speed may exceed its limit, because motors follow their target
    with an error. A command reported as applied may not exceed a limit at all."""
    speed_error: ClassVar[float] = 0.05
    """Error of a joint's measured speed, by which it may also exceed its limit, m/s and rad/s."""
    position_error: ClassVar[float] = 0.01
    """Error of a measured position, by which it may exceed its limit, m and rad."""
    kinds: ClassVar[Sequence[str]] = ()
    """Kinds of command that the robot declares; read from the spec of a new driver by default."""
    sample_types: ClassVar[Sequence[type[CommandSamples]]] = (EndEffectorSamples, JointSamples)
    """Sources of commands, one for each kind that the robot may declare."""

    @abstractmethod
    def make_driver(self) -> RobotDriver:
        """Return a new driver, not open and without a latched fault."""

    @pytest.fixture
    def driver(self) -> Iterator[RobotDriver]:
        """Yield a driver; close it, and clear its fault, after the test."""
        made = self.make_driver()
        yield made
        _close_and_clear(made)

    @pytest.fixture
    def other_driver(self) -> Iterator[RobotDriver]:
        """Yield a second driver."""
        if not self.several:
            pytest.skip("this robot allows one driver at a time: several is False")
        made = self.make_driver()
        yield made
        _close_and_clear(made)

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Parametrize tests that take a `kind` by the kinds of command that the spec declares."""
        if "kind" in metafunc.fixturenames:
            metafunc.parametrize("kind", _declared_kinds(type(self)))

    def samples(self, driver: RobotDriver, kind: str) -> CommandSamples:
        """Return the source of commands of a kind."""
        for sample_type in self.sample_types:
            if sample_type.kind == kind:
                return sample_type(driver.spec)
        pytest.fail(
            f"the suite has no commands of kind {kind!r}; subclass CommandSamples for it, and add "
            "the class to sample_types"
        )

    def start(self, driver: RobotDriver) -> RobotState:
        """Open, reset and arm; return the first state."""
        driver.open()
        self.reset(driver)
        driver.arm()
        return driver.read()

    def reset(self, driver: RobotDriver, request: ResetRequest | None = None) -> None:
        """Reset, and assert that it is done."""
        result = driver.reset(ResetRequest() if request is None else request)
        assert result.outcome is ResetOutcome.DONE, (
            f"the suite needs a robot that resets without a person; reset returned {result}"
        )

    def accept(self, driver: RobotDriver, command: Command) -> None:
        """Send a valid command that answers the newest state, and assert that it is accepted."""
        acceptance = driver.command(command)
        assert acceptance.accepted, (
            "an armed robot must accept a valid command that answers the newest state, got "
            f"{acceptance}"
        )

    def tick(self, driver: RobotDriver, samples: CommandSamples, sign: float = 1.0) -> RobotState:
        """Run one tick with a small command; return the state at its end."""
        self.accept(driver, samples.small(driver.read(), sign))
        driver.advance()
        return driver.read()

    def applied_at_once(self, state: RobotState) -> AppliedCommand | None:
        """Return the command applied in the tick after the state that it answers, else None.

        None is possible in real time only, where a test may miss ticks.

        Args:
            state: The newest state, after an accepted command.
        """
        applied = state.applied
        assert applied is not None, "an accepted command must be reported as applied"
        answered = applied.command.answers
        assert answered < applied.tick <= state.seq, (
            f"`applied.tick` is {applied.tick}, allowed: above {answered}, the state that the "
            f"command answers, and up to {state.seq}, the newest state"
        )
        at_once = applied.tick == state.seq == answered + 1
        assert at_once or self.real_time, (
            "a command must be applied in the tick after the state that it answers: it answers "
            f"{answered}, `applied.tick` is {applied.tick}, and the newest state is {state.seq}"
        )
        return applied if at_once else None

    def hold(self, driver: RobotDriver, ticks: int) -> RobotState:
        """Run ticks without a command; return the last state."""
        for _ in range(ticks):
            driver.advance()
        return driver.read()

    def assert_at_rest(self, driver: RobotDriver, requirement: str) -> None:
        """Assert that the end effector does not move in the next ticks.

        Args:
            driver: The robot.
            requirement: Requirement of the contract, for the message.
        """
        before, ticks = driver.read(), 5
        after = self.hold(driver, ticks)
        way = float(np.linalg.norm(after.ee_pos - before.ee_pos))
        allowed = self.rest_speed * ticks * driver.spec.control_period_s
        assert way <= allowed, (
            f"{requirement}; the end effector moved {way:.2g} m in {ticks} ticks, allowed: "
            f"{allowed:.2g} m"
        )


def must_raise(error: type[Error], call: Callable[[], object], what: str) -> Error:
    """Assert that a call raises an error.

    Args:
        error: Type of the error.
        call: The call.
        what: Description of the call, for the message.

    Returns:
        The error.
    """
    try:
        call()
    except error as raised:
        return raised
    raise AssertionError(f"{what} must raise {error.__name__}, nothing was raised")


def _close_and_clear(driver: RobotDriver) -> None:
    driver.close()
    if driver.fault is not None:  # the host of a remote robot keeps it for the next test
        driver.clear_fault(driver.fault.name)


@functools.cache
def _declared_kinds(suite: type[ContractSuite]) -> tuple[str, ...]:
    return tuple(suite.kinds) or suite().make_driver().spec.command_kinds
