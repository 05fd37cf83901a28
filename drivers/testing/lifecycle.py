"""Contract of the lifecycle: which calls are allowed in which state, and how they end."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from drivers import (
    FaultLatched,
    LifecycleError,
    Mode,
    Refusal,
    ResetRequest,
    RobotDriver,
)
from drivers.testing.suite import ContractSuite, must_raise


class DeliberateError(Exception):
    """Raised by the suite in the body of a ``with`` block."""


_CALLS: dict[str, Callable[[RobotDriver], object]] = {
    "open": RobotDriver.open,
    "arm": RobotDriver.arm,
    "read": RobotDriver.read,
    "advance": RobotDriver.advance,
    "reset": lambda driver: driver.reset(ResetRequest()),
    "disarm": RobotDriver.disarm,
    "stop": lambda driver: driver.stop("the suite stops it"),
    "close": RobotDriver.close,
}

# The result of a call in a situation: (open, armed) afterwards, or an error that changes nothing.
_TABLE: dict[str, dict[str, tuple[bool, bool] | type[Exception]]] = {
    "closed": {
        "open": (True, False),
        "arm": LifecycleError,
        "read": LifecycleError,
        "advance": LifecycleError,
        "reset": LifecycleError,
        "disarm": (False, False),
        "stop": (False, False),
        "close": (False, False),
    },
    "open": {
        "open": LifecycleError,
        "arm": (True, True),
        "read": (True, False),
        "advance": (True, False),
        "reset": (True, False),
        "disarm": (True, False),
        "stop": (True, False),
        "close": (False, False),
    },
    "armed": {
        "open": LifecycleError,
        "arm": LifecycleError,
        "read": (True, True),
        "advance": (True, True),
        "reset": LifecycleError,
        "disarm": (True, False),
        "stop": (True, False),
        "close": (False, False),
    },
    "stopped": {
        "open": LifecycleError,
        "arm": FaultLatched,
        "read": (True, False),
        "advance": (True, False),
        "reset": FaultLatched,
        "disarm": (True, False),
        "stop": (True, False),
        "close": (False, False),
    },
}


def _bring(driver: RobotDriver, situation: str) -> None:
    if situation != "closed":
        driver.open()
    if situation in ("armed", "stopped"):
        driver.arm()
    if situation == "stopped":
        driver.stop("the suite stops it")


class LifecycleTests(ContractSuite):
    """``open -> arm -> (read | command | advance)* -> disarm -> close``."""

    @pytest.mark.parametrize("call", _CALLS)
    @pytest.mark.parametrize("situation", _TABLE)
    def test_each_call_is_allowed_exactly_where_the_lifecycle_says(
        self, driver: RobotDriver, situation: str, call: str
    ) -> None:
        _bring(driver, situation)
        before, expected = (driver.is_open, driver.is_armed), _TABLE[situation][call]
        demand = f"{call} on a driver that is {situation}"
        if isinstance(expected, tuple):
            _CALLS[call](driver)
        else:
            must_raise(expected, lambda: _CALLS[call](driver), demand)
            expected = before
        assert (driver.is_open, driver.is_armed) == expected, (
            f"after {demand}, (is_open, is_armed) must be {expected}"
        )

    def test_a_command_is_taken_only_while_armed(self, driver: RobotDriver, kind: str) -> None:
        state = self.start(driver)
        command = self.samples(driver, kind).small(state)
        self.accept(driver, command)
        driver.disarm()
        acceptance = driver.command(command)
        assert acceptance.refusal is Refusal.DISARMED, (
            f"a command to a disarmed robot must be refused as disarmed, got {acceptance}"
        )
        driver.close()
        must_raise(LifecycleError, lambda: driver.command(command), "command on a closed driver")

    def test_disarming_drops_an_accepted_command(self, driver: RobotDriver, kind: str) -> None:
        state = self.start(driver)
        self.accept(driver, self.samples(driver, kind).small(state))
        driver.disarm()
        driver.disarm()
        driver.advance()
        after = driver.read()
        assert after.applied is None, "a command accepted before disarm must not be applied after"
        assert after.mode is Mode.DISARMED, f"the mode must be disarmed, is {after.mode}"
        self.assert_at_rest(driver, "a disarmed robot must be held")

    def test_disarming_in_motion_brings_the_robot_to_rest(
        self, driver: RobotDriver, kind: str
    ) -> None:
        self.start(driver)
        for _ in range(5):
            self.tick(driver, self.samples(driver, kind))
        driver.disarm()
        self.hold(driver, self.settling_ticks)
        self.assert_at_rest(driver, "a disarmed robot must be held")

    def test_close_is_idempotent_and_the_driver_opens_again(self, driver: RobotDriver) -> None:
        driver.close()
        self.start(driver)
        driver.close()
        driver.close()
        assert not driver.is_armed, "a closed driver must be disarmed"
        assert self.start(driver).mode is Mode.HELD, "an armed robot without a command must be held"

    def test_a_context_ends_held_and_disarmed_when_its_body_raises(
        self, driver: RobotDriver, kind: str
    ) -> None:
        def episode() -> None:
            with driver:
                self.reset(driver)
                driver.arm()
                self.tick(driver, self.samples(driver, kind))
                raise DeliberateError

        must_raise(DeliberateError, episode, "a `with` block must not swallow an error of its body")
        assert not driver.is_armed, "a `with` block must end disarmed"
        assert not driver.is_open, "a `with` block must end closed"
        with driver:
            assert driver.read().mode is Mode.DISARMED, "a robot that opens again must be disarmed"
            self.hold(driver, self.settling_ticks)
            self.assert_at_rest(driver, "a robot must be held after a `with` block")

    def test_the_description_needs_no_connection_and_never_changes(
        self, driver: RobotDriver
    ) -> None:
        before = driver.spec.to_dict()
        self.start(driver)
        assert driver.spec.to_dict() == before, "the spec must be the same before and after open"

    def test_equal_robots_have_equal_digests(
        self, driver: RobotDriver, other_driver: RobotDriver
    ) -> None:
        mine, other = driver.spec, other_driver.spec
        assert mine.interface_digest == other.interface_digest, mine.interface_differences(other)
        assert mine.body_digest == other.body_digest, mine.body_differences(other)

    def test_two_drivers_are_independent(
        self, driver: RobotDriver, other_driver: RobotDriver, kind: str
    ) -> None:
        self.start(driver)
        before = self.start(other_driver)
        self.tick(driver, self.samples(driver, kind))
        driver.command(self.samples(driver, kind).small(before))
        driver.stop("the suite stops one of two")
        assert other_driver.fault is None, "a stop must not latch a fault in another driver"
        assert other_driver.is_armed, "a stop must not disarm another driver"
        assert other_driver.refusals == {}, "each driver must count its own refusals"
        assert other_driver.read().applied is None, "a command must not move another driver's robot"
        self.tick(other_driver, self.samples(other_driver, kind))
