"""State of a robot: joints, end effector, fingers, objects, mode and applied command."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from drivers.command import Command

Array = NDArray[np.float64]


def _freeze(*arrays: Array) -> None:
    for array in arrays:
        array.setflags(write=False)


class Mode(StrEnum):
    """Mode of a robot. In every mode its joints are powered."""

    DISARMED = "disarmed"
    """Held, and the command gate is closed."""
    HELD = "held"
    """Armed, zero motion: no fresh command."""
    MOVING = "moving"
    """Armed, following a command."""
    STOPPED = "stopped"
    """Held by a latched fault."""


@dataclass(frozen=True, eq=False)
class AppliedCommand:
    """The last command that was applied.

    Attributes:
        tick: Sequence of the state at the end of the tick in which it was applied.
        command: The command after every limit.
        clipped: Why it differs from the requested one; empty if it does not.
    """

    tick: int
    command: Command
    clipped: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class JointSetpoint:
    """Target that the robot's motors follow. Its arrays become read-only.

    Attributes:
        q: Joint positions, rad or m. ``(n_joints,)``
        dq: Joint velocities. ``(n_joints,)``
        fingers: Finger positions, m. ``(n_fingers,)``
    """

    q: Array
    dq: Array
    fingers: Array

    def __post_init__(self) -> None:
        _freeze(self.q, self.dq, self.fingers)


@dataclass(frozen=True, eq=False)
class ObjectPose:
    """Pose of an object as measured by one sensor. Its arrays become read-only.

    Attributes:
        pos: m, in `frame`. ``(3,)``
        quat: wxyz. ``(4,)``
        linvel: m/s. ``(3,)``
        angvel: rad/s. ``(3,)``
        stamp_ns: Time of measurement, on the robot's clock.
        source: The sensor.
        frame: Frame of everything above.
    """

    pos: Array
    quat: Array
    linvel: Array
    angvel: Array
    stamp_ns: int
    source: str
    frame: str

    def __post_init__(self) -> None:
        _freeze(self.pos, self.quat, self.linvel, self.angvel)


@dataclass(frozen=True, eq=False)
class RobotState:
    """State of a robot in one control tick. Its arrays become read-only.

    Attributes:
        seq: The robot's tick counter.
        stamp_ns: Time of measurement, on the robot's clock.
        q: Joint positions, rad or m, in the order of `RobotSpec.joint_names`. ``(n_joints,)``
        dq: Joint velocities. ``(n_joints,)``
        ee_pos: End effector in the spec's frame, m. ``(3,)``
        ee_quat: wxyz. ``(4,)``
        ee_linvel: m/s. ``(3,)``
        ee_angvel: rad/s. ``(3,)``
        fingers_pos: m, in the order of `RobotSpec.finger_names`. ``(n_fingers,)``
        fingers_vel: m/s. ``(n_fingers,)``
        mode: Mode of the robot.
        fault: Name of the latched fault, None without one.
        applied: The last command that was applied, None if none was since the reset.
        setpoint: Target of the motors at the end of this tick, after every limit; a controller
            starts from it. None for a robot that takes no joint commands.
        objects: Pose of each object, by name.
    """

    seq: int
    stamp_ns: int
    q: Array
    dq: Array
    ee_pos: Array
    ee_quat: Array
    ee_linvel: Array
    ee_angvel: Array
    fingers_pos: Array
    fingers_vel: Array
    mode: Mode
    fault: str | None
    applied: AppliedCommand | None
    objects: Mapping[str, ObjectPose]
    setpoint: JointSetpoint | None = None

    def __post_init__(self) -> None:
        _freeze(self.q, self.dq, self.ee_pos, self.ee_quat, self.ee_linvel, self.ee_angvel)
        _freeze(self.fingers_pos, self.fingers_vel)
