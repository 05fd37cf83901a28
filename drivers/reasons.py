"""Why a command was cut."""

from __future__ import annotations

from enum import StrEnum


class Clip(StrEnum):
    """The limits that the safety filter cuts commands to."""

    POSITION_SCALE = "position_scale"
    """A displacement beyond what an action can ask for."""
    GRIPPER_SCALE = "gripper_scale"
    """The same of the fingers."""
    JOINT_SPEED = "joint_speed"
    JOINT_ACCELERATION = "joint_acceleration"
    JOINT_RANGE = "joint_range"
    """A position limit that braking could no longer keep."""
    EE_SPEED = "ee_speed"
    WORKSPACE = "workspace"
    """The end effector would leave the workspace, at the latest while it brakes."""
    KEEP_OUT = "keep_out"
    """A part of the arm would enter what it must keep out of, such as the table."""
    FINGER_RANGE = "finger_range"
    FINGER_SPEED = "finger_speed"
