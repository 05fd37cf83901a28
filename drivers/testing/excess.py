"""Contract of the limits: commands far beyond them are cut, reported and counted."""

from __future__ import annotations

import numpy as np

from drivers import (
    AppliedCommand,
    EndEffectorCommand,
    JointCommand,
    RobotDriver,
    RobotSpec,
    RobotState,
)
from drivers.testing.suite import ContractSuite

_EXCURSIONS = 10
_TICKS_A_WAY = 10
_LATE_TICKS = 5
"""Commands of an excursion that may expire on a robot in real time, whose link may be busy."""
_OUT_AND_BACK = (1.0, -1.0)
"""Signs of the two halves of an excursion. Each starts at home, where the robot is least likely to
hit itself or an object: a missed tick changes the way back, so that errors would add up."""
_ROUNDING = 1e-6


class ExcessTests(ContractSuite):
    """No command exceeds a limit, and every cut is reported."""

    def test_excessive_commands_stay_within_every_limit_and_are_reported(
        self, driver: RobotDriver, kind: str
    ) -> None:
        driver.open()
        excursions = [self._excursion(driver, kind, seed) for seed in range(_EXCURSIONS)]
        farthest = max(distance for distance, _ in excursions)
        late = sum(count for _, count in excursions)
        cut = _EXCURSIONS * len(_OUT_AND_BACK) * _TICKS_A_WAY - late
        assert sum(driver.clips.values()) >= cut, (
            f"`clips` must count every cut by its reason: {cut} commands were cut, counted: "
            f"{driver.clips}"
        )
        assert farthest > self.home_tolerance, (
            f"commands that are cut must still move the robot, it moved by {farthest:.4f} m"
        )

    def test_after_excess_the_robot_comes_to_rest(self, driver: RobotDriver, kind: str) -> None:
        rng = np.random.default_rng(0)
        samples = self.samples(driver, kind)
        before = self.start(driver)
        for tick in range(_TICKS_A_WAY + self.settling_ticks):
            if tick < _TICKS_A_WAY:
                driver.command(samples.excessive(before, rng))
            after = self.hold(driver, 1)
            self._assert_state_within(after, before, driver.spec)
            before = after
        self.assert_at_rest(driver, "held ticks must bring the robot to rest from full speed")

    def _excursion(self, driver: RobotDriver, kind: str, seed: int) -> tuple[float, int]:
        """Move out from home in a random direction, and back.

        Returns:
            The farthest distance, m, and the commands that came late and were not applied.
        """
        self.reset(driver)
        driver.arm()
        samples, farthest, late = self.samples(driver, kind), 0.0, 0
        start = before = driver.read()
        for sign in _OUT_AND_BACK:
            for _ in range(_TICKS_A_WAY):
                rng = np.random.default_rng(seed)  # the same direction in every tick
                acceptance = driver.command(samples.excessive(before, rng, sign))
                assert acceptance.accepted, (
                    f"a command beyond the limits must be cut, not refused, got {acceptance}"
                )
                after = self.hold(driver, 1)
                applied = after.applied
                assert applied is not None, "an accepted command must be reported as applied"
                if applied.tick > before.seq:
                    assert applied.clipped, "`applied.clipped` must say why a command was cut"
                    assert_command_within(applied, before, driver.spec)
                else:  # the command came late and expired, and nothing was applied since
                    late += 1
                self._assert_state_within(after, before, driver.spec)
                farthest = max(farthest, float(np.linalg.norm(after.ee_pos - start.ee_pos)))
                before = after
        driver.disarm()
        allowed = _LATE_TICKS if driver.paces_itself else 0
        assert late <= allowed, (
            f"{late} accepted commands were not applied in the next ticks, allowed: {allowed}"
        )
        return farthest, late

    def _assert_state_within(self, state: RobotState, before: RobotState, spec: RobotSpec) -> None:
        limits, faster = spec.limits, 1.0 + self.overshoot
        time_s = (state.seq - before.seq) * spec.control_period_s
        way = float(np.linalg.norm(state.ee_pos - before.ee_pos))
        speed = max(float(np.linalg.norm(state.ee_linvel)), way / time_s)
        assert speed <= limits.max_ee_speed_m_s * faster, (
            f"the end effector moves at {speed:.3f} m/s, allowed: {limits.max_ee_speed_m_s} m/s"
        )
        lower, upper = np.array(limits.workspace.lower), np.array(limits.workspace.upper)
        outside = float(np.maximum(lower - state.ee_pos, state.ee_pos - upper).max())
        assert outside <= self.position_error, (
            f"the end effector is at {state.ee_pos}, {outside:.3f} m outside of the workspace "
            f"{limits.workspace.lower} to {limits.workspace.upper}"
        )
        if not spec.enforces_joint_limits:
            return
        for name, q, dq in zip(spec.joint_names, state.q, state.dq, strict=True):
            joint, error = limits.joints[name], self.position_error
            assert joint.lower - error <= q <= joint.upper + error, (
                f"joint {name} is at {q:.4f}, allowed: {joint.lower} to {joint.upper}"
            )
            assert abs(dq) <= joint.max_velocity * faster + self.speed_error, (
                f"joint {name} moves at {dq:.4f} rad/s or m/s, allowed: {joint.max_velocity}"
            )


def assert_command_within(applied: AppliedCommand, before: RobotState, spec: RobotSpec) -> None:
    """Assert that a command reported as applied is within the limits.

    Ticks that were missed before it may have changed the velocity, too.

    Args:
        applied: The command.
        before: The state that it answers.
        spec: The robot.
    """
    command = applied.command
    if isinstance(command, EndEffectorCommand):
        _assert_displacement_within(command, spec)
    elif isinstance(command, JointCommand):
        _assert_motion_within(command, before, applied.tick - before.seq, spec)


def _assert_displacement_within(command: EndEffectorCommand, spec: RobotSpec) -> None:
    for name, delta, scale in (
        ("delta_pos", command.delta_pos, spec.action.position_scale_m),
        ("finger_delta", command.finger_delta, spec.action.gripper_scale_m),
    ):
        assert np.abs(delta).max(initial=0.0) <= scale * (1.0 + _ROUNDING), (
            f"{name} applied is {delta} m, allowed: {scale} m along each axis"
        )


def _assert_motion_within(
    command: JointCommand, before: RobotState, ticks: int, spec: RobotSpec
) -> None:
    setpoint = before.setpoint
    assert setpoint is not None
    for i, (name, joint) in enumerate(spec.limits.joints.items()):
        q, dq = float(command.q_target[i]), float(command.dq[i])
        assert joint.lower - _ROUNDING <= q <= joint.upper + _ROUNDING, (
            f"q_target applied to {name} is {q}, allowed: {joint.lower} to {joint.upper}"
        )
        assert abs(dq) <= joint.max_velocity * (1.0 + _ROUNDING), (
            f"dq applied to {name} is {dq}, allowed: {joint.max_velocity}"
        )
        most = joint.max_acceleration * spec.control_period_s * ticks
        change = abs(dq - float(setpoint.dq[i]))
        assert change <= most * (1.0 + _ROUNDING) + _ROUNDING, (
            f"dq applied to {name} changes by {change} in {ticks} ticks, allowed: {most}"
        )
    gripper = spec.limits.gripper
    within = (command.finger_target >= gripper.lower_m - _ROUNDING) & (
        command.finger_target <= gripper.upper_m + _ROUNDING
    )
    assert within.all(), (
        f"finger_target applied is {command.finger_target}, "
        f"allowed: {gripper.lower_m} to {gripper.upper_m} m"
    )
