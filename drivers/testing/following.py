"""Joint motions: every joint and every finger goes where its setpoint is, and no other does."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from drivers import JointCommand, RobotDriver, RobotState
from drivers.testing.command_samples import JointSamples
from drivers.testing.suite import ContractSuite

_TICKS = 6


class FollowingTests(ContractSuite):
    """What the motors follow is what the state says, joint by joint."""

    def test_each_joint_goes_where_its_setpoint_is(self, driver: RobotDriver) -> None:
        samples = self._joint_samples(driver)
        state = self.start(driver)
        for joint, name in enumerate(driver.spec.joint_names):
            before = state
            speeds = []
            for _ in range(_TICKS):
                assert driver.command(samples.small(state, joint=joint)).accepted
                driver.advance()
                state = driver.read()
                speeds.append(state.dq[joint])
            moving, state = state, self.hold(driver, self.settling_ticks)
            setpoint = _setpoint_q(state)
            assert setpoint[joint] != _setpoint_q(before)[joint], f"the setpoint of {name} moves"
            np.testing.assert_allclose(
                state.q,
                setpoint,
                rtol=0.0,
                atol=self.position_error,
                err_msg=f"after a motion of {name} every joint is where its setpoint is",
            )
            way = moving.q[joint] - before.q[joint]
            measured = float(np.sum(speeds)) * driver.spec.control_period_s
            assert measured * np.sign(way) > 0.5 * abs(way), (
                f"the speeds of {name} add up to its way: {measured:.4f}, not {way:.4f}"
            )

    def test_fingers_go_where_they_are_told_and_stay(self, driver: RobotDriver) -> None:
        samples = self._joint_samples(driver)
        if not driver.spec.finger_names:
            pytest.skip("this robot has no fingers")
        state, limits = self.start(driver), driver.spec.limits.gripper
        step = limits.max_speed_m_s * driver.spec.control_period_s
        for target in (limits.upper_m, limits.lower_m):
            for _ in range(_TICKS):
                before = _fingers(state)
                still = dataclasses.replace(samples.still(state), finger_target=before * 0 + target)
                assert driver.command(still).accepted
                driver.advance()
                state = driver.read()
                moved = np.abs(_fingers(state) - before)
                assert (moved <= step * (1 + 1e-6)).all(), "fingers keep their speed limit"
            told = _fingers(state)
            state = self.hold(driver, self.settling_ticks)
            np.testing.assert_allclose(
                _fingers(state), told, atol=1e-9, err_msg="a held tick leaves the fingers alone"
            )
            np.testing.assert_allclose(
                state.fingers_pos,
                told,
                rtol=0.0,
                atol=self.position_error,
                err_msg="the fingers are where they were told to be",
            )

    def _joint_samples(self, driver: RobotDriver) -> JointSamples:
        if JointCommand.kind not in driver.spec.command_kinds:
            pytest.skip("this robot takes no joint commands")
        samples = self.samples(driver, JointCommand.kind)
        assert isinstance(samples, JointSamples)
        return samples


def _setpoint_q(state: RobotState) -> np.ndarray:
    assert state.setpoint is not None, "a robot that takes joint commands reports its setpoint"
    return state.setpoint.q


def _fingers(state: RobotState) -> np.ndarray:
    assert state.setpoint is not None, "a robot that takes joint commands reports its setpoint"
    return state.setpoint.fingers
