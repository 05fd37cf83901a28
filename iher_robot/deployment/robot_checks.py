"""Whether a robot stands where it believes to stand: at home, and within its joints' ranges."""

from __future__ import annotations

import numpy as np

from drivers import RobotSpec, RobotState
from iher_robot.env.goal_env import ResetFailed

HOME_TOLERANCE_M = 0.05
"""How far from home the end effector may be after a reset."""

# Noise, and the sag of an arm, rad or m.
_JOINT_TOLERANCE = 0.01


def metres_from_home(spec: RobotSpec, state: RobotState) -> float:
    """Distance of the end effector from where a reset should bring it."""
    return float(np.linalg.norm(state.ee_pos - np.array(spec.home.ee_pos)))


def require_home(spec: RobotSpec, state: RobotState) -> None:
    """Check that a reset brought the robot home.

    Args:
        spec: The robot.
        state: Measured after the reset.

    Raises:
        ResetFailed: Its end effector is elsewhere, or a joint is outside its range.
    """
    sentence = not_home_sentence(spec, state)
    if sentence is not None:
        raise ResetFailed(sentence)
    outside = joints_outside(spec, state)
    if outside:
        raise ResetFailed(
            f"after its reset {'; '.join(outside)} of {spec.name}; check calibration and limits"
        )


def not_home_sentence(spec: RobotSpec, state: RobotState) -> str | None:
    """Say that a reset did not bring the end effector home; None if it did.

    Args:
        spec: The robot.
        state: Measured after the reset.
    """
    away_m = metres_from_home(spec, state)
    if away_m <= HOME_TOLERANCE_M:  # never so of nan
        return None
    return (
        f"after its reset the end effector of {spec.name} is {away_m * 100:.1f} cm from home, "
        f"allowed: {HOME_TOLERANCE_M * 100:g} cm; check calibration and kinematic model"
    )


def joints_outside(spec: RobotSpec, state: RobotState) -> list[str]:
    """Name every joint that is measured outside its range; none where ranges are not enforced."""
    if not spec.enforces_joint_limits:
        return []
    return [
        f"joint {name} is at {q:.4f}, allowed: {limits.lower:g} to {limits.upper:g}"
        for (name, limits), q in zip(spec.limits.joints.items(), state.q, strict=True)
        if not limits.lower - _JOINT_TOLERANCE <= q <= limits.upper + _JOINT_TOLERANCE
    ]


def latched_sentence(robot: str, fault: str, reason: str) -> str:
    """Say what stopped a robot and how it is cleared.

    Args:
        robot: Name of the robot.
        fault: Name of the latched fault.
        reason: What happened, in words.
    """
    return (
        f"{robot} is stopped by {fault!r} ({reason}); once it is safe, clear it with: iher-robot "
        f"clear-fault {fault}"
    )
