"""Checks of a robot and of the speed to run it at, as errors or sentences for the operator."""

from __future__ import annotations

import numpy as np

from drivers import RobotDriver, RobotSpec, RobotState
from iher_robot.env.goal_env import ResetFailed
from iher_robot.errors import UserError

HOME_TOLERANCE_M = 0.05
"""Largest distance of the end effector from home after a reset."""

# Noise, and the sag of an arm, rad or m.
_JOINT_TOLERANCE = 0.01


def check_speed(speed: float) -> None:
    """Raise `UserError` unless a speed is a share of full speed, in (0, 1]."""
    if not 0.0 < speed <= 1.0:
        raise UserError(f"speed is {speed}, allowed: above 0 and up to 1, a share of full speed")


def metres_from_home(spec: RobotSpec, state: RobotState) -> float:
    """Distance of the end effector from home."""
    return float(np.linalg.norm(state.ee_pos - np.array(spec.home.ee_pos)))


def require_home(spec: RobotSpec, state: RobotState) -> None:
    """Check that a reset brought the robot home.

    Args:
        spec: The robot.
        state: Measured after the reset.

    Raises:
        ResetFailed: The end effector is elsewhere, or a joint is outside its range.
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
    """Sentence for a reset that did not bring the end effector home; None if it did.

    Args:
        spec: The robot.
        state: Measured after the reset.
    """
    away_m = metres_from_home(spec, state)
    if away_m <= HOME_TOLERANCE_M:  # false for nan
        return None
    return (
        f"after its reset the end effector of {spec.name} is {away_m * 100:.1f} cm from home, "
        f"allowed: {HOME_TOLERANCE_M * 100:g} cm; check calibration and kinematic model"
    )


def joints_outside(spec: RobotSpec, state: RobotState) -> list[str]:
    """A phrase for each joint measured outside its range; empty where ranges are not enforced."""
    if not spec.enforces_joint_limits:
        return []
    return [
        f"joint {name} is at {q:.4f}, allowed: {limits.lower:g} to {limits.upper:g}"
        for (name, limits), q in zip(spec.limits.joints.items(), state.q, strict=True)
        if not limits.lower - _JOINT_TOLERANCE <= q <= limits.upper + _JOINT_TOLERANCE
    ]


def fault_sentence(driver: RobotDriver) -> str | None:
    """Sentence for the latched fault of a robot; None without one."""
    fault = driver.fault
    if fault is None:
        return None
    return latched_sentence(driver.spec.name, fault.name, fault.reason)


def latched_sentence(robot: str, fault: str, reason: str) -> str:
    """Sentence with a latched fault and the command that clears it.

    Args:
        robot: Name of the robot.
        fault: Name of the latched fault.
        reason: Reason of the fault.
    """
    return (
        f"{robot} is stopped by {fault!r} ({reason}); once it is safe, clear it with: iher-robot "
        f"clear-fault {fault}"
    )
