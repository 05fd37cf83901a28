"""Parameters of a simulated Fetch robot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drivers.errors import InvalidSpec
from drivers.validation import describe_problems

Actuation = Literal["joint", "mocap"]


class _Section(BaseModel):
    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


class ArmParameters(_Section):
    """Motors of torso and arm; joint actuation only."""

    kp: float = Field(default=1e5, ge=1e3, le=1e6)
    """Stiffness of the position control, Nm/rad and N/m."""
    damping_ratio: float = Field(default=1.0, ge=0.1, le=10)
    """Damping of the position control; 1 is critical."""
    joint_damping: float = Field(default=50.0, ge=0, le=1e4)
    """Viscous friction of each arm joint, Nm s/rad."""
    acceleration_scale: float = Field(default=1.0, ge=0.05, le=1)
    """Share of the robot's acceleration limits that is allowed."""
    delay_ticks: int = Field(default=0, ge=0, le=10)
    """Delay of the motors behind the setpoint, control ticks."""


class GripperParameters(_Section):
    """Motors of the fingers; joint actuation only."""

    kp: float = Field(default=3e4, ge=1e3, le=1e5)
    """Stiffness of the position control, N/m."""
    max_force_n: float = Field(default=60.0, ge=1, le=1e3)
    """Greatest force of a finger."""


class ObjectParameters(_Section):
    """The object on the table."""

    mass_scale: float = Field(default=1.0, ge=0.01, le=100)
    """Its mass, as a multiple of the scene's."""
    friction_scale: float = Field(default=1.0, ge=0.01, le=100)
    """Sliding friction of object and table, as a multiple of the scene's."""


class SensorParameters(_Section):
    """Noise, rate and delay of measurements. Noise is normal, independent in each tick and axis."""

    joint_noise: float = Field(default=0.0, ge=0, le=0.1)
    """Standard deviation of joint positions, rad and m."""
    joint_velocity_noise: float = Field(default=0.0, ge=0, le=1)
    """Standard deviation of joint velocities, rad/s and m/s."""
    object_noise_m: float = Field(default=0.0, ge=0, le=0.1)
    """Standard deviation of the object's position."""
    object_turn_noise: float = Field(default=0.0, ge=0, le=1)
    """Standard deviation of the object's orientation about each axis, rad."""
    object_rate_hz: float | None = Field(default=None, ge=1, le=1e3)
    """Measurements per second of the object's pose; None for one in each tick."""
    object_delay_s: float = Field(default=0.0, ge=0, le=1)
    """Time from the measurement of the object's pose to its report."""


class FetchRobot(_Section):
    """Parameters of one simulated Fetch robot: the settings of a file in ``configs/robots``."""

    actuation: Actuation = "joint"
    """Position-controlled joints, or a mocap body that drags the gripper along."""
    arm: ArmParameters = ArmParameters()
    gripper: GripperParameters = GripperParameters()
    object: ObjectParameters = ObjectParameters()
    sensors: SensorParameters = SensorParameters()


def fetch_robot(options: Mapping[str, object]) -> FetchRobot:
    """Read the parameters of a robot.

    Args:
        options: As in a file of ``configs/robots``; missing keys have their defaults.

    Raises:
        InvalidSpec: If a key is unknown or a value not allowed.
    """
    try:
        return FetchRobot.model_validate(options)
    except ValidationError as error:
        raise InvalidSpec(describe_problems(error, FetchRobot, "robot setting")) from None
