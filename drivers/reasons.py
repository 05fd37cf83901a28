"""Reasons for which the safety filter cuts a command."""

from __future__ import annotations

from enum import StrEnum


class Clip(StrEnum):
    """The limit that a command exceeded."""

    POSITION_SCALE = "position_scale"
    """A displacement of the end effector larger than that of an action of 1."""
    GRIPPER_SCALE = "gripper_scale"
    """A displacement of the fingers larger than that of an action of 1."""
    JOINT_SPEED = "joint_speed"
    JOINT_ACCELERATION = "joint_acceleration"
    JOINT_RANGE = "joint_range"
    """A joint would leave its range, at the latest while it brakes."""
    EE_SPEED = "ee_speed"
    WORKSPACE = "workspace"
    """The end effector would leave the workspace, at the latest while it brakes."""
    KEEP_OUT = "keep_out"
    """A guarded part of the arm would enter a keep-out box, such as the table."""
    FINGER_RANGE = "finger_range"
    FINGER_SPEED = "finger_speed"
