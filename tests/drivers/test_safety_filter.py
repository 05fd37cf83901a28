"""Many command sequences on the simulator, of which none breaks a limit.

Invalid and excessive commands, which must be refused, cut or raise, are mixed with valid ones, so
that the robot moves.
"""

from __future__ import annotations

import dataclasses
import logging
import os
from collections import Counter
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers import InvalidCommand, JointCommand, Kinematics, Refusal, RobotState
from drivers.mujoco import MujocoDriver
from drivers.region import Region

Array = NDArray[np.float64]

SEQUENCES = int(os.environ.get("IHER_ROBOT_SEQUENCES", "1000"))
"""Of all starts together; `make test-full` sets 10,000."""
N_JOINTS, PERIOD_S = 8, 0.04
# The motors follow their setpoints but for this, in free space.
SLACK_RAD, SLACK_SPEED, SLACK_M = 0.01, 0.1, 0.003

STARTS = ("home", "fast", "stretched", "at the table")


@cache
def driver() -> MujocoDriver:
    made = MujocoDriver("reach")
    made.open()
    return made


@cache
def kinematics() -> Kinematics:
    return Kinematics(driver().spec)


@cache
def bounds() -> tuple[Array, Array, Array]:
    joints = driver().spec.limits.joints.values()
    lower, upper, speed = np.array([(j.lower, j.upper, j.max_velocity) for j in joints]).T
    return lower, upper, speed


def towards(state: RobotState, velocity: Array) -> JointCommand:
    """Return a valid command for an end-effector velocity, m/s, within the acceleration limits."""
    assert state.setpoint is not None
    q, dq_now, fingers = state.setpoint.q, state.setpoint.dq, state.setpoint.fingers
    jacobian = kinematics().ee_jacobian(q)[:, 1:]  # the torso rests
    wanted = np.concatenate([[0.0], np.linalg.pinv(jacobian, rcond=0.1) @ velocity])
    most = np.array([j.max_acceleration for j in driver().spec.limits.joints.values()]) * PERIOD_S
    change = wanted - dq_now
    dq = dq_now + change / max(1.0, float((np.abs(change) / most).max()))
    return JointCommand(state.seq, q + (dq_now + dq) / 2 * PERIOD_S, dq, PERIOD_S, fingers)


@cache
def start(name: str) -> mujoco.MjData:
    """Return a start state of sequences, moving or near a limit."""
    robot = driver()
    robot.disarm()
    robot.restore(initial())
    rearm()
    velocity, ticks = {
        "home": ((0.0, 0.0, 0.0), 1),
        "fast": ((0.0, 0.8, 0.0), 10),
        "stretched": ((0.6, 0.0, 0.1), 30),
        "at the table": ((0.0, 0.0, -0.3), 30),
    }[name]
    for _ in range(ticks):
        robot.command(towards(robot.read(), np.array(velocity)))
        robot.advance()
    snapshot = robot.snapshot()
    robot.disarm()
    return snapshot


@cache
def initial() -> mujoco.MjData:
    return driver().snapshot()


@dataclass
class Totals:
    """Totals over all sequences."""

    travelled_m: float = 0.0
    applied_as_asked: int = 0
    seen: Counter[str] = field(default_factory=Counter)


BAD = ("far", "fast", "nan", "shape", "expired", "unknown", "disarmed", "stopped", "limp")
COMMANDS = st.one_of(
    st.tuples(st.just("good"), st.integers(0, 2**32 - 1)),
    st.tuples(st.sampled_from(BAD), st.integers(0, 2**32 - 1)),
)


def make(kind: str, seed: int, state: RobotState) -> JointCommand:
    rng = np.random.default_rng(seed)
    good = towards(state, rng.normal(size=3) * rng.choice([0.05, 0.3, 0.6]))
    spoiled = good.q_target.copy()
    spoiled[rng.integers(N_JOINTS)] = rng.choice([np.nan, np.inf])
    far, fast = 100 * rng.normal(size=N_JOINTS), 50 * rng.normal(size=N_JOINTS)
    changes: dict[str, Any] = {
        "far": {"q_target": far, "finger_target": np.ones(2)},
        "fast": {"dq": fast, "duration_s": 1e-4, "finger_target": np.array([9.0, -9.0])},
        "limp": {"duration_s": 50.0},
        "nan": {"q_target": spoiled},
        "shape": {"q_target": good.q_target[:-1]},
        "unknown": {"answers": state.seq + 5},
    }
    return dataclasses.replace(good, **changes.get(kind, {}))


def send(kind: str, command: JointCommand) -> None:
    """Send a command, and check its acceptance and the counters."""
    robot = driver()
    refused, clips = robot.refusals, robot.clips
    if kind in ("nan", "shape"):
        with pytest.raises(InvalidCommand):
            robot.command(command)
        assert (robot.refusals, robot.clips) == (refused, clips)
        return
    if kind == "expired":
        for _ in range(3):  # the answer comes too late
            robot.advance()
    if kind == "disarmed":
        robot.disarm()
    if kind == "stopped":
        robot.stop("test")
    expected = {
        "disarmed": Refusal.DISARMED,
        "stopped": Refusal.LATCHED,
        "expired": Refusal.EXPIRED,
        "unknown": Refusal.UNKNOWN_STATE,
    }.get(kind)
    answer = robot.command(command)
    assert answer.refusal is expected
    if expected is not None:
        assert answer.message
        assert robot.refusals[expected] == refused.get(expected, 0) + 1
        assert robot.clips == clips


def rearm() -> None:
    robot = driver()
    if robot.fault is not None:
        robot.clear_fault(robot.fault.name)
    if not robot.is_armed:
        robot.arm()


def check(before: RobotState, after: RobotState) -> None:
    lower, upper, speed = bounds()
    spec = driver().spec
    setpoint = after.setpoint
    assert setpoint is not None
    assert before.setpoint is not None
    assert ((lower <= setpoint.q) & (setpoint.q <= upper)).all()
    assert (np.abs(setpoint.dq) <= speed * (1 + 1e-8)).all()
    ee_speed = np.linalg.norm(kinematics().ee_jacobian(setpoint.q) @ setpoint.dq)
    assert ee_speed <= spec.limits.max_ee_speed_m_s * (1 + 1e-8)
    # The measured state, too, not only the setpoint.
    assert ((lower - SLACK_RAD <= after.q) & (after.q <= upper + SLACK_RAD)).all()
    assert (np.abs(after.dq) <= speed + SLACK_SPEED).all()
    assert np.linalg.norm(after.ee_linvel) <= spec.limits.max_ee_speed_m_s + SLACK_SPEED
    points = kinematics().guarded_points(after.q)
    depths = Region(spec.limits).depths(points, kinematics().guard_radii)
    assert np.concatenate(list(depths.values())).max() <= SLACK_M
    applied = after.applied
    if applied is not None and applied.tick == after.seq:
        assert isinstance(applied.command, JointCommand)
        np.testing.assert_array_equal(applied.command.q_target, setpoint.q)


@pytest.fixture(autouse=True)
def quiet(caplog: pytest.LogCaptureFixture) -> None:
    """Hide the warnings of hundreds of stops."""
    caplog.set_level(logging.ERROR, "drivers.driver")


@pytest.mark.parametrize("name", STARTS)
def test_no_sequence_of_commands_takes_the_robot_out_of_its_limits(name: str) -> None:
    totals = Totals()

    @settings(
        max_examples=SEQUENCES // len(STARTS),
        deadline=None,
        suppress_health_check=list(HealthCheck),
        database=None,
    )
    @given(st.lists(COMMANDS, min_size=1, max_size=8))
    def run(commands: list[tuple[str, int]]) -> None:
        robot = driver()
        snapshot = start(name)
        robot.disarm()
        robot.restore(snapshot)
        rearm()
        state = robot.read()
        for kind, seed in commands:
            command = make(kind, seed, state)
            send(kind, command)
            robot.advance()
            after = robot.read()
            check(state, after)
            totals.seen[kind] += 1
            totals.travelled_m += float(np.linalg.norm(after.ee_pos - state.ee_pos))
            applied = after.applied
            fresh = applied is not None and applied.tick == after.seq
            assert fresh == (kind in ("good", "far", "fast", "limp")), kind
            if kind == "good" and applied is not None and not applied.clipped:
                totals.applied_as_asked += 1
                np.testing.assert_allclose(vars(applied.command)["dq"], command.dq, atol=1e-12)
            rearm()
            state = after

    run()
    assert totals.travelled_m > 0.002 * sum(totals.seen.values()), "it must really move"
    assert totals.applied_as_asked > 0.2 * totals.seen["good"], "good commands must be applied"
    assert set(totals.seen) == {"good", *BAD}
