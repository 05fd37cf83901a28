"""Contract of joint commands: each joint and finger follows its own setpoint."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from drivers import JointCommand, RobotDriver, RobotState
from drivers.testing.command_samples import JointSamples
from drivers.testing.suite import ContractSuite

_TICKS = 6


class FollowingTests(ContractSuite):
    """The robot follows the setpoint that its state reports, joint by joint."""

    def test_each_joint_goes_where_its_setpoint_is(self, driver: RobotDriver) -> None:
        samples = self._joint_samples(driver)
        state = self.start(driver)
        for joint, name in enumerate(driver.spec.joint_names):
            before = state
            measured = 0.0
            for _ in range(_TICKS):
                self.accept(driver, samples.small(state, joint=joint))
                driver.advance()
                last, state = state, driver.read()
                ticks = state.seq - last.seq  # more than one where a tick was missed
                measured += float(state.dq[joint]) * ticks * driver.spec.control_period_s
            moving, state = state, self.hold(driver, self.settling_ticks)
            setpoint = _setpoint_q(state)
            assert setpoint[joint] != _setpoint_q(before)[joint], (
                f"commands to joint {name} must move its setpoint"
            )
            np.testing.assert_allclose(
                state.q,
                setpoint,
                rtol=0.0,
                atol=self.position_error,
                err_msg=f"after a motion of {name} every joint must be where its setpoint is",
            )
            way = moving.q[joint] - before.q[joint]
            assert measured * np.sign(way) > 0.5 * abs(way), (
                f"the velocities of {name} must add up to its displacement {way:.4f}, they add up "
                f"to {measured:.4f} rad or m"
            )

    def test_fingers_reach_their_targets_and_stay(self, driver: RobotDriver) -> None:
        samples = self._joint_samples(driver)
        if not driver.spec.finger_names:
            pytest.skip("this robot has no fingers")
        state, limits = self.start(driver), driver.spec.limits.gripper
        step = limits.max_speed_m_s * driver.spec.control_period_s
        for target in (limits.upper_m, limits.lower_m):
            for _ in range(_TICKS):
                before = _fingers(state)
                still = dataclasses.replace(samples.still(state), finger_target=before * 0 + target)
                self.accept(driver, still)
                driver.advance()
                state = driver.read()
                moved = np.abs(_fingers(state) - before)
                assert (moved <= step * (1 + 1e-6)).all(), (
                    f"finger setpoints move by {moved} m in a tick, allowed: {step} m"
                )
            setpoint = _fingers(state)
            state = self.hold(driver, self.settling_ticks)
            np.testing.assert_allclose(
                _fingers(state),
                setpoint,
                atol=1e-9,
                err_msg="a held tick must not move the finger setpoints",
            )
            np.testing.assert_allclose(
                state.fingers_pos,
                setpoint,
                rtol=0.0,
                atol=self.position_error,
                err_msg="the fingers must be where their setpoints are",
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
