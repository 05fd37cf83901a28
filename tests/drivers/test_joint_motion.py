"""Limits of joint motions, on a whole arm, without a simulator."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers import JointCommand, JointSetpoint, Kinematics, RobotSpec
from drivers.joint_motion import JointMotion
from drivers.mujoco import MujocoDriver
from drivers.region import Region

Array = NDArray[np.float64]
N_JOINTS = 8
PERIOD_S = 0.04
_EXACT = 1e-8
# From zero to far beyond the limits.
SIZES = st.sampled_from([0.0, 0.01, 0.1, 0.5, 1.0, 3.0, 1000.0, 1e200])


@cache
def spec() -> RobotSpec:
    return MujocoDriver("push").spec


@cache
def motion() -> JointMotion:
    return JointMotion(spec())


@cache
def kinematics() -> Kinematics:
    return Kinematics(spec())


def limits() -> tuple[Array, Array, Array, Array]:
    joints = spec().limits.joints.values()
    rows = [(j.lower, j.upper, j.max_velocity, j.max_acceleration) for j in joints]
    lower, upper, speed, acceleration = np.array(rows).T
    return lower, upper, speed, acceleration


def home() -> JointSetpoint:
    return JointSetpoint(np.array(spec().home.q), np.zeros(N_JOINTS), np.zeros(2))


def lifted() -> JointSetpoint:
    """Well above the table and off the torso's end."""
    q = home().q.copy()
    q[[0, 2]] += (0.05, -0.3)
    return JointSetpoint(q, np.zeros(N_JOINTS), np.zeros(2))


def step(
    start: JointSetpoint, dq: Array, duration_s: float = PERIOD_S, scale: float = 1.0
) -> tuple[JointSetpoint, tuple[str, ...]]:
    """Request a velocity at the end of the tick, with the matching target."""
    q_target = start.q + (start.dq + dq) / 2.0 * duration_s
    command = JointCommand(0, q_target, dq, duration_s, start.fingers)
    applied, reasons = motion().limit(command, start, scale)
    end = JointSetpoint(applied.q_target.copy(), applied.dq.copy(), applied.finger_target.copy())
    return end, reasons


def depths(q: Array) -> Array:
    points = kinematics().guarded_points(q)
    found = Region(spec().limits).depths(points, kinematics().guard_radii)
    return np.concatenate(list(found.values()))


def assert_within_limits(start: JointSetpoint, end: JointSetpoint) -> None:
    lower, upper, speed, acceleration = limits()
    assert (end.q >= lower - _EXACT).all()
    assert (end.q <= upper + _EXACT).all()
    assert (np.abs(end.dq) <= speed * (1 + _EXACT)).all()
    assert (np.abs(end.dq - start.dq) <= acceleration * PERIOD_S * (1 + _EXACT)).all()
    np.testing.assert_allclose(end.q, start.q + (start.dq + end.dq) / 2 * PERIOD_S, atol=1e-12)
    ee_speed = np.linalg.norm(kinematics().ee_jacobian(end.q) @ end.dq)
    assert ee_speed <= spec().limits.max_ee_speed_m_s * (1 + _EXACT)
    for share in (0.25, 0.5, 0.75, 1.0):
        between = start.dq + share * (end.dq - start.dq)
        q = start.q + (start.dq + between) / 2 * share * PERIOD_S
        # The filter checks points of the path; between them it bends by a tenth of a millimetre.
        assert (depths(q) <= 2e-4).all()


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 2**32 - 1), st.lists(SIZES, min_size=5, max_size=40))
def test_no_sequence_of_commands_breaks_a_limit_or_misses_a_stop(
    seed: int, sizes: list[float]
) -> None:
    rng = np.random.default_rng(seed)
    _, _, speed, _ = limits()
    now, direction = home(), rng.normal(size=N_JOINTS)
    for size in sizes:
        if rng.random() < 0.3:  # otherwise keep the direction, until a limit stops the motion
            direction = rng.normal(size=N_JOINTS)
        end, _ = step(
            now,
            size * speed * direction,
            duration_s=float(rng.choice([1e-300, 0.01, 0.04, 1, 1e8])),
        )
        assert_within_limits(now, end)
        now = end
    for _ in range(100):
        if not now.dq.any():
            break  # at rest, where braking changes nothing any more
        end = motion().brake(now)
        assert_within_limits(now, end)
        now = end
    np.testing.assert_array_equal(now.dq, 0.0)
    np.testing.assert_array_equal(motion().brake(now).q, now.q)


@settings(deadline=None)
@given(st.lists(st.floats(-0.2, 0.2), min_size=N_JOINTS, max_size=N_JOINTS))
def test_a_motion_within_every_limit_is_applied_unchanged(parts: list[float]) -> None:
    _, _, _, acceleration = limits()
    dq = np.array(parts) * acceleration * PERIOD_S
    end, reasons = step(lifted(), dq)
    assert reasons == ()
    np.testing.assert_allclose(end.dq, dq, atol=1e-12)


@settings(deadline=None)
@given(st.lists(st.floats(-1, 1), min_size=N_JOINTS, max_size=N_JOINTS), st.floats(0.05, 1.0))
def test_from_rest_a_motion_is_slowed_down_as_a_whole(parts: list[float], scale: float) -> None:
    asked = np.array(parts)
    end, reasons = step(lifted(), 50.0 * asked, scale=scale)
    _, _, speed, _ = limits()
    assert (np.abs(end.dq) <= scale * speed * (1 + _EXACT)).all()
    if np.abs(asked).max() > 0.2:
        assert reasons
    length = np.linalg.norm(asked) * np.linalg.norm(end.dq)
    assert asked @ end.dq == pytest.approx(length, abs=1e-9)  # parallel


@pytest.mark.parametrize("duration_s", [0.04, 0.2])
def test_a_target_that_is_repeated_is_reached_at_rest(duration_s: float) -> None:
    _, _, _, acceleration = limits()
    target = lifted().q + 0.05 * acceleration * PERIOD_S**2
    now = lifted()
    for _ in range(2 if duration_s == 0.04 else 60):
        command = JointCommand(0, target, np.zeros(N_JOINTS), duration_s, np.zeros(2))
        applied, reasons = motion().limit(command, now, 1.0)
        assert reasons == ()
        now = JointSetpoint(applied.q_target, applied.dq, applied.finger_target)
    np.testing.assert_allclose(now.q, target, atol=1e-4 if duration_s > 0.04 else 1e-12)
    np.testing.assert_allclose(now.dq, 0.0, atol=1e-3 if duration_s > 0.04 else 1e-12)


def test_from_outside_a_limit_the_way_back_is_open_and_no_other() -> None:
    start = home()
    q = start.q.copy()
    q[6] = 2.2  # the wrist's range ends at 2.16
    outside = JointSetpoint(q, start.dq.copy(), start.fingers.copy())
    back, further = np.zeros(N_JOINTS), np.zeros(N_JOINTS)
    back[6], further[6] = -0.1, 0.1
    end, reasons = step(outside, back)
    assert reasons == ()
    assert end.q[6] < outside.q[6]
    end, reasons = step(outside, further)
    assert "joint_range" in reasons
    assert end.q[6] <= outside.q[6] + _EXACT


@given(
    st.lists(st.floats(-0.01, 0.06), min_size=2, max_size=2),
    st.lists(st.floats(-1, 1), min_size=2, max_size=2),
    st.floats(0.1, 1.0),
)
def test_fingers_keep_their_range_and_speed(
    now: list[float], target: list[float], scale: float
) -> None:
    start = dataclasses.replace(home(), fingers=np.array(now))
    command = JointCommand(0, start.q, start.dq, PERIOD_S, np.array(target))
    applied, reasons = motion().limit(command, start, scale)
    gripper = spec().limits.gripper
    step_m = gripper.max_speed_m_s * PERIOD_S * scale
    assert (np.abs(applied.finger_target - start.fingers) <= step_m + _EXACT).all()
    inside = np.clip(target, gripper.lower_m, gripper.upper_m)
    assert ("finger_range" in reasons) == bool((inside != target).any())
    towards = np.sign(applied.finger_target - start.fingers) == np.sign(inside - start.fingers)
    assert towards.all()
