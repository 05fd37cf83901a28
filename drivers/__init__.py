"""Robot drivers, simulated and remote, with their safety filter."""

from __future__ import annotations

from drivers.clock import Clock, MonotonicClock, SimulatedClock
from drivers.command import (
    Acceptance,
    Command,
    EndEffectorCommand,
    JointCommand,
    Refusal,
    ResetOutcome,
    ResetRequest,
    ResetResult,
)
from drivers.driver import EMERGENCY_STOP, RobotDriver
from drivers.errors import (
    DriverError,
    FaultLatched,
    HandsNotClear,
    InvalidCommand,
    InvalidRequest,
    InvalidSpec,
    LeaseRefused,
    LifecycleError,
    LinkLost,
    StaleState,
    UnknownDriver,
)
from drivers.gate import Fault
from drivers.kinematics import Kinematics
from drivers.limits import Box, GripperLimits, JointLimits, Limits
from drivers.registry import driver_targets, make_driver
from drivers.rendering import Renderable
from drivers.safety import SafetyFilter
from drivers.spec import ActionSpec, Home, ObjectSource, RobotSpec
from drivers.state import AppliedCommand, JointSetpoint, Mode, ObjectPose, RobotState

__all__ = [
    "EMERGENCY_STOP",
    "Acceptance",
    "ActionSpec",
    "AppliedCommand",
    "Box",
    "Clock",
    "Command",
    "DriverError",
    "EndEffectorCommand",
    "Fault",
    "FaultLatched",
    "GripperLimits",
    "HandsNotClear",
    "Home",
    "InvalidCommand",
    "InvalidRequest",
    "InvalidSpec",
    "JointCommand",
    "JointLimits",
    "JointSetpoint",
    "Kinematics",
    "LeaseRefused",
    "LifecycleError",
    "Limits",
    "LinkLost",
    "Mode",
    "MonotonicClock",
    "ObjectPose",
    "ObjectSource",
    "Refusal",
    "Renderable",
    "ResetOutcome",
    "ResetRequest",
    "ResetResult",
    "RobotDriver",
    "RobotSpec",
    "RobotState",
    "SafetyFilter",
    "SimulatedClock",
    "StaleState",
    "UnknownDriver",
    "driver_targets",
    "make_driver",
]
