"""Contract of control ticks: their counter, their length, and ticks without a command."""

from __future__ import annotations

import numpy as np

from drivers import Mode, RobotDriver, RobotState
from drivers.testing.suite import ContractSuite

_TICKS = 20
_JITTER = 0.5
"""Share of a period by which the median tick of a robot in real time may be too short. It may be
too long on a busy machine."""


class TickTests(ContractSuite):
    """The robot's side owns time and the tick counter."""

    def test_every_tick_counts_one(self, driver: RobotDriver) -> None:
        states = self._empty_ticks(driver)
        rises = np.diff([state.seq for state in states])
        assert rises.min() >= 1, f"seq must rise with every tick, it rose by {rises}"
        assert np.median(rises) == 1, f"seq must rise by 1 per tick, it rose by {rises}"
        if not self.real_time:
            assert rises.max() == 1, f"seq must rise by 1 per tick, it rose by {rises}"

    def test_every_tick_lasts_a_control_period(self, driver: RobotDriver) -> None:
        states = self._empty_ticks(driver)
        lengths = np.diff([state.stamp_ns for state in states])
        period_ns = driver.spec.control_period_ns
        demand = f"stamps must rise by the control period of {period_ns} ns, they rose by {lengths}"
        if self.real_time:
            assert lengths.min() > 0, demand
            assert np.median(lengths) >= (1.0 - _JITTER) * period_ns, demand
        else:
            assert (lengths == period_ns).all(), demand

    def test_reading_twice_in_a_tick_gives_one_state(self, driver: RobotDriver) -> None:
        if self.real_time:
            return  # a robot in real time may have measured again
        self.start(driver)
        first, second = driver.read(), driver.read()
        assert (first.seq, first.stamp_ns) == (second.seq, second.stamp_ns)
        np.testing.assert_array_equal(first.q, second.q, "read must not change the state")
        np.testing.assert_array_equal(first.ee_pos, second.ee_pos, "read must not change the state")

    def test_the_tick_counter_never_falls(self, driver: RobotDriver) -> None:
        seen = [self.start(driver).seq]
        seen.append(self.hold(driver, 2).seq)
        driver.disarm()
        self.reset(driver)
        seen.append(driver.read().seq)
        driver.close()
        driver.open()
        seen.append(driver.read().seq)
        assert seen == sorted(seen), f"seq must never fall, also over a reset or restart: {seen}"
        assert seen[1] < seen[2], f"seq must rise over a reset: {seen}"

    def test_a_tick_without_a_command_is_held(self, driver: RobotDriver, kind: str) -> None:
        self.start(driver)
        for _ in range(5):
            moving = self.tick(driver, self.samples(driver, kind))
        held = self.hold(driver, 1)
        assert held.mode is Mode.HELD, (
            f"the mode after a tick without an accepted command must be held, is {held.mode}"
        )
        assert held.applied is not None, "`applied` must stay in the states after its tick"
        assert held.applied.tick <= moving.seq < held.seq, (
            "`applied` must not change in a tick without a command"
        )
        self.hold(driver, self.settling_ticks)
        self.assert_at_rest(driver, "held ticks must bring the robot to rest")

    def test_arming_moves_nothing(self, driver: RobotDriver) -> None:
        driver.open()
        self.reset(driver)
        before = self.hold(driver, self.settling_ticks)
        driver.arm()
        self.assert_at_rest(driver, "an armed robot must stay held until its first command")
        driver.disarm()
        self.assert_at_rest(driver, "disarming a robot at rest must not move it")
        allowed = 15 * self.rest_speed * driver.spec.control_period_s
        np.testing.assert_allclose(
            driver.read().ee_pos, before.ee_pos, atol=allowed, err_msg="arming must not move it"
        )

    def test_the_setpoint_never_jumps(self, driver: RobotDriver, kind: str) -> None:
        samples = self.samples(driver, kind)
        state = self.start(driver)
        if state.setpoint is None:
            return  # only a robot that takes joint commands has one, which StateTests check
        for act in "move move move hold move disarm hold arm hold move move".split():
            before = driver.read()
            if act in ("arm", "disarm"):
                getattr(driver, act)()
                self._assert_continuous(driver, before, driver.read(), act)
            elif act == "move":
                self._assert_continuous(driver, before, self.tick(driver, samples), act)
            else:
                self._assert_continuous(driver, before, self.hold(driver, 1), act)

    def _empty_ticks(self, driver: RobotDriver) -> list[RobotState]:
        self.start(driver)
        states = []
        for _ in range(_TICKS):
            driver.advance()
            states.append(driver.read())
        return states

    def _assert_continuous(
        self, driver: RobotDriver, before: RobotState, after: RobotState, act: str
    ) -> None:
        first, last = before.setpoint, after.setpoint
        assert first is not None and last is not None, (  # noqa: PT018 - one demand
            "a robot that takes joint commands must report its setpoint in every state"
        )
        joints = driver.spec.limits.joints.values()
        time_s = (after.seq - before.seq) * driver.spec.control_period_s
        most = np.array([joint.max_acceleration for joint in joints]) * time_s
        change = np.abs(last.dq - first.dq)
        assert (change <= most * (1.0 + 1e-6) + 1e-9).all(), (
            f"the setpoint's velocity jumps by {change} at {act}, allowed: {most}"
        )
        if after.seq - before.seq > 1:
            return  # the states in between are unknown
        travelled = (first.dq + last.dq) / 2.0 * time_s
        np.testing.assert_allclose(
            last.q,
            first.q + travelled,
            atol=1e-6,
            err_msg=f"the setpoint must move with its velocity; it jumps at {act}",
        )
