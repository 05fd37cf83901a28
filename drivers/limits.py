"""The limits that a robot declares: joints, gripper, end effector, workspace, watchdog."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.errors import InvalidSpec

Vector3 = tuple[float, float, float]


def check_positive(name: str, value: float) -> None:
    """Check that a limit is positive.

    Args:
        name: Name for the message.
        value: The limit; infinity means no limit.

    Raises:
        InvalidSpec: If it is zero, negative or not a number.
    """
    if not value > 0:
        raise InvalidSpec(f"{name} is {value}, allowed: above 0")


@dataclass(frozen=True)
class JointLimits:
    """Limits of one joint.

    Attributes:
        lower: Lower end of the range, rad or m; minus infinity for a continuous joint.
        upper: Upper end of the range, rad or m.
        max_velocity: rad/s or m/s.
        max_acceleration: rad/s^2 or m/s^2.
    """

    lower: float
    upper: float
    max_velocity: float
    max_acceleration: float

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise InvalidSpec(
                f"joint range is [{self.lower}, {self.upper}], allowed: lower < upper"
            )
        check_positive("max_velocity", self.max_velocity)
        check_positive("max_acceleration", self.max_acceleration)


@dataclass(frozen=True)
class Box:
    """An axis-aligned box in the spec's frame, in metres."""

    lower: Vector3
    upper: Vector3

    def __post_init__(self) -> None:
        if not all(low < high for low, high in zip(self.lower, self.upper, strict=True)):
            raise InvalidSpec(f"box is {self.lower} to {self.upper}, allowed: lower < upper")


@dataclass(frozen=True)
class GripperLimits:
    """Limits of each finger.

    Attributes:
        lower_m: Position when closed.
        upper_m: Position when open.
        max_speed_m_s: Greatest speed of a finger.
    """

    lower_m: float
    upper_m: float
    max_speed_m_s: float

    def __post_init__(self) -> None:
        if not self.lower_m < self.upper_m:
            raise InvalidSpec(
                f"gripper range is [{self.lower_m}, {self.upper_m}], allowed: lower < upper"
            )
        check_positive("max_speed_m_s", self.max_speed_m_s)


@dataclass(frozen=True)
class Limits:
    """Every limit that a robot declares.

    Attributes:
        joints: Limits by joint name, in the order of `RobotState.q`.
        gripper: Limits of the fingers.
        max_ee_speed_m_s: Speed of the end effector.
        workspace: Where the end effector may be.
        keep_out: Boxes that no guarded part of the arm may enter, such as the table.
        watchdog_s: Greatest age of a state that a command may answer; without a fresh command for
            this long the robot holds.
        reduced_speed_scale: Share of every speed that is allowed after human help, in (0, 1].
    """

    joints: dict[str, JointLimits]
    gripper: GripperLimits
    max_ee_speed_m_s: float
    workspace: Box
    watchdog_s: float
    reduced_speed_scale: float = 0.25
    keep_out: tuple[Box, ...] = ()

    def __post_init__(self) -> None:
        check_positive("max_ee_speed_m_s", self.max_ee_speed_m_s)
        check_positive("watchdog_s", self.watchdog_s)
        if not math.isfinite(self.watchdog_s):
            raise InvalidSpec("watchdog_s is infinite, allowed: a time in seconds")
        if not 0 < self.reduced_speed_scale <= 1:
            raise InvalidSpec(f"reduced_speed_scale is {self.reduced_speed_scale}, allowed: (0, 1]")
