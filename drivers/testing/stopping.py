"""Contract of `stop`: immediate, from any thread, and latched until it is cleared by name."""

from __future__ import annotations

import threading

from drivers import (
    EMERGENCY_STOP,
    FaultLatched,
    LifecycleError,
    Mode,
    Refusal,
    ResetRequest,
    RobotDriver,
)
from drivers.testing.suite import ContractSuite, must_raise

_STUCK_AFTER_S = 30.0
"""Time after which a thread counts as stuck; no tick takes this long."""


class StopTests(ContractSuite):
    """`stop` closes the gate at once, holds, and latches."""

    def test_a_stop_latches_until_it_is_cleared_by_name(
        self, driver: RobotDriver, kind: str
    ) -> None:
        state, samples = self.start(driver), self.samples(driver, kind)
        driver.command(samples.small(state))
        driver.stop("someone walked in")
        driver.stop("a later reason")
        assert driver.fault is not None, "a stop must latch a fault"
        assert driver.fault.reason == "someone walked in", (
            f"the first stop must be kept, not a later one: {driver.fault.reason!r}"
        )
        driver.advance()
        stopped = driver.read()
        assert (stopped.mode, stopped.fault) == (Mode.STOPPED, EMERGENCY_STOP), (
            "a state after a stop must have mode stopped and the name of the fault"
        )
        assert stopped.applied is None, "a command accepted before the stop must not be applied"
        acceptance = driver.command(samples.small(stopped))
        assert acceptance.refusal is Refusal.LATCHED, (
            f"a command to a stopped robot must be refused as latched, got {acceptance}"
        )
        must_raise(FaultLatched, driver.arm, "arm while a fault is latched")
        must_raise(
            FaultLatched, lambda: driver.reset(ResetRequest()), "reset while a fault is latched"
        )
        must_raise(
            LifecycleError, lambda: driver.clear_fault("another"), "clear_fault with a wrong name"
        )
        driver.clear_fault(EMERGENCY_STOP)
        assert not driver.is_armed, "clear_fault must not arm"
        assert driver.fault is None, "clear_fault must clear the fault"
        must_raise(
            LifecycleError,
            lambda: driver.clear_fault(EMERGENCY_STOP),
            "clear_fault without a latched fault",
        )
        driver.arm()
        self.accept(driver, samples.small(driver.read()))

    def test_a_latched_stop_survives_close_and_open(self, driver: RobotDriver) -> None:
        driver.stop("pressed before the robot was opened")
        driver.open()
        driver.close()
        driver.open()
        assert driver.read().mode is Mode.STOPPED, "a stop must survive close and open"
        must_raise(FaultLatched, driver.arm, "arm after a stop, close and open")

    def test_a_stop_in_motion_brings_the_robot_to_rest(
        self, driver: RobotDriver, kind: str
    ) -> None:
        self.start(driver)
        for _ in range(5):
            self.tick(driver, self.samples(driver, kind))
        driver.stop("someone walked in")
        self.hold(driver, self.settling_ticks)
        self.assert_at_rest(driver, "a stopped robot must be held")

    def test_a_stop_from_another_thread_ends_motion(self, driver: RobotDriver, kind: str) -> None:
        self.start(driver)
        samples = self.samples(driver, kind)
        moving, finished = threading.Event(), threading.Event()
        refusals: list[Refusal | None] = []

        def episode() -> None:
            try:
                while refusals.count(Refusal.LATCHED) < 3:
                    refusals.append(driver.command(samples.small(driver.read())).refusal)
                    driver.advance()
                    if len(refusals) == 3:
                        moving.set()
            finally:
                finished.set()

        ticking = threading.Thread(target=episode, daemon=True)
        ticking.start()
        assert moving.wait(_STUCK_AFTER_S), "an armed robot must take commands tick by tick"
        driver.stop("pressed")
        assert not driver.is_armed, "the gate must be closed when stop returns"
        at_stop = driver.read()
        assert finished.wait(_STUCK_AFTER_S), (
            "after a stop from another thread, ticks must continue and commands be refused"
        )
        ticking.join(_STUCK_AFTER_S)
        assert set(refusals) == {None, Refusal.LATCHED}, (
            f"commands must be accepted before a stop and refused as latched after it: {refusals}"
        )
        after = driver.read()
        assert after.mode is Mode.STOPPED, f"the mode after a stop must be stopped, is {after.mode}"
        assert after.applied is not None, "`applied` must still report the last command"
        assert after.applied.tick <= at_stop.seq, (
            f"no command must be applied after stop has returned in tick {at_stop.seq}; one was in "
            f"tick {after.applied.tick}"
        )

    def test_stops_disarms_and_closes_from_many_threads_end_disarmed(
        self, driver: RobotDriver
    ) -> None:
        self.start(driver)
        calls = [lambda: driver.stop("pressed"), driver.disarm, driver.close] * 3
        threads = [threading.Thread(target=call, daemon=True) for call in calls]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(_STUCK_AFTER_S)
        assert not any(thread.is_alive() for thread in threads), (
            "stop, disarm and close from many threads must not block each other"
        )
        assert (driver.is_open, driver.is_armed) == (False, False), (
            "a driver must be closed and disarmed after close from any thread"
        )
        assert driver.fault is not None, "a stop must stay latched after disarm and close"
