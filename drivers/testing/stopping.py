"""The emergency stop: at once, from any thread, latched until it is cleared by name."""

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

_PATIENCE_S = 30.0
"""After which a thread counts as stuck; no tick is this long."""


class StopTests(ContractSuite):
    """`stop` closes the gate at once, holds, and latches."""

    def test_a_stop_latches_until_it_is_cleared_by_name(
        self, driver: RobotDriver, kind: str
    ) -> None:
        state, samples = self.start(driver), self.samples(driver, kind)
        driver.command(samples.small(state))
        driver.stop("someone walked in")
        driver.stop("a later reason")
        assert driver.fault is not None, "a stop latches a fault"
        assert driver.fault.reason == "someone walked in", "the first stop is the one kept"
        driver.advance()
        stopped = driver.read()
        assert (stopped.mode, stopped.fault) == (Mode.STOPPED, EMERGENCY_STOP), (
            "a state says that the robot is stopped, and by which fault"
        )
        assert stopped.applied is None, "a command accepted before the stop must not be applied"
        assert driver.command(samples.small(stopped)).refusal is Refusal.LATCHED
        must_raise(FaultLatched, driver.arm, "arm while a fault is latched")
        must_raise(FaultLatched, lambda: driver.reset(ResetRequest()), "reset while latched")
        must_raise(LifecycleError, lambda: driver.clear_fault("another"), "the wrong name clears")
        driver.clear_fault(EMERGENCY_STOP)
        assert not driver.is_armed, "clearing never arms"
        assert driver.fault is None
        must_raise(LifecycleError, lambda: driver.clear_fault(EMERGENCY_STOP), "nothing to clear")
        driver.arm()
        assert driver.command(samples.small(driver.read())).accepted

    def test_a_latched_stop_survives_close_and_open(self, driver: RobotDriver) -> None:
        driver.stop("pressed before the robot was even opened")
        driver.open()
        driver.close()
        driver.open()
        assert driver.read().mode is Mode.STOPPED, "a stop survives close and open"
        must_raise(FaultLatched, driver.arm, "a stop survives close and open")

    def test_a_stop_in_motion_brings_the_robot_to_rest(
        self, driver: RobotDriver, kind: str
    ) -> None:
        self.start(driver)
        for _ in range(5):
            self.tick(driver, self.samples(driver, kind))
        driver.stop("someone walked in")
        self.hold(driver, self.settling_ticks)
        self.assert_at_rest(driver, "a stopped robot is held")

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
        assert moving.wait(_PATIENCE_S), "an armed robot takes commands tick by tick"
        driver.stop("pressed")
        assert not driver.is_armed, "the gate is closed when stop returns"
        at_stop = driver.read()
        assert finished.wait(_PATIENCE_S), "after a stop commands are refused and ticks go on"
        ticking.join(_PATIENCE_S)
        assert set(refusals) == {None, Refusal.LATCHED}
        after = driver.read()
        assert after.mode is Mode.STOPPED
        assert after.applied is not None
        assert after.applied.tick <= at_stop.seq, "nothing is applied after stop has returned"

    def test_stops_disarms_and_closes_from_many_threads_end_disarmed(
        self, driver: RobotDriver
    ) -> None:
        self.start(driver)
        calls = [lambda: driver.stop("pressed"), driver.disarm, driver.close] * 3
        threads = [threading.Thread(target=call, daemon=True) for call in calls]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(_PATIENCE_S)
        assert not any(thread.is_alive() for thread in threads), (
            "stop, disarm and close are idempotent, from any thread, and none waits for another"
        )
        assert (driver.is_open, driver.is_armed) == (False, False)
        assert driver.fault is not None, "the stop is latched whatever came after it"
