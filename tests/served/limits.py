"""Limits that every state of a served robot must keep, whatever messages it gets."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from drivers import RobotSpec, RobotState
from drivers.remote.state_message import HostInfo

OVERSHOOT = 0.15
POSITION_ERROR = 0.01  # m and rad
SPEED_ERROR = 0.05  # m/s and rad/s


def assert_within_limits(seen: Sequence[tuple[RobotState, HostInfo]], spec: RobotSpec) -> None:
    states = [state for state, _ in seen]
    limits, faster = spec.limits, 1.0 + OVERSHOOT
    joints = [limits.joints[name] for name in spec.joint_names]
    q, dq = (np.array([getattr(state, name) for state in states]) for name in ("q", "dq"))
    ee_pos = np.array([state.ee_pos for state in states])
    ee_speed = np.linalg.norm([state.ee_linvel for state in states], axis=1)
    lower, upper = (np.array([getattr(j, side) for j in joints]) for side in ("lower", "upper"))
    most = np.array([joint.max_velocity for joint in joints])
    assert np.isfinite(q).all() and np.isfinite(dq).all()  # noqa: PT018
    assert (q >= lower - POSITION_ERROR).all() and (q <= upper + POSITION_ERROR).all()  # noqa: PT018
    assert (np.abs(dq) <= most * faster + SPEED_ERROR).all(), f"joint speeds {np.abs(dq).max(0)}"
    assert ee_speed.max() <= limits.max_ee_speed_m_s * faster, f"{ee_speed.max()} m/s"
    workspace = limits.workspace
    assert (ee_pos >= np.array(workspace.lower) - POSITION_ERROR).all()
    assert (ee_pos <= np.array(workspace.upper) + POSITION_ERROR).all()
    for (before, was), (after, now) in itertools.pairwise(seen):
        if not (was.armed and now.armed):
            continue  # a reset of a simulated robot is a jump
        ticks = after.seq - before.seq
        assert ticks > 0
        way = np.abs(after.q - before.q)
        if (way > (most * faster + SPEED_ERROR) * ticks * spec.control_period_s).any():
            raise AssertionError(f"{way} rad in {ticks} ticks, at {after.seq}")
