"""Description of a robot, available without a connection to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from drivers.canonical import Json, differences, digest, to_json
from drivers.errors import InvalidSpec
from drivers.limits import Limits, Vector3, check_positive

Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True)
class ActionSpec:
    """Meaning and scale of a policy's action on this robot.

    Attributes:
        names: What each component moves.
        position_scale_m: Displacement of the end effector for an action of 1.
        gripper_scale_m: Displacement of each finger for an action of 1.
        frame: Frame of the displacement.
    """

    names: tuple[str, ...] = ("dx", "dy", "dz", "gripper")
    position_scale_m: float = 0.05
    gripper_scale_m: float = 1.0
    frame: str = "world"

    def __post_init__(self) -> None:
        check_positive("position_scale_m", self.position_scale_m)
        check_positive("gripper_scale_m", self.gripper_scale_m)

    @property
    def dim(self) -> int:
        """Length of an action."""
        return len(self.names)


@dataclass(frozen=True)
class ObjectSource:
    """Source of an object's pose.

    Attributes:
        source: The sensor or tracker, such as ``"simulator"``.
        frame: Frame of the pose.
        max_age_s: Age beyond which a pose of this sensor is stale. A 15 Hz camera is not stale at
            25 Hz.
    """

    source: str
    frame: str
    max_age_s: float

    def __post_init__(self) -> None:
        check_positive("max_age_s", self.max_age_s)


@dataclass(frozen=True)
class Home:
    """Pose of the robot after a reset.

    Attributes:
        ee_pos: Position of the end effector in the spec's frame, m.
        ee_quat: Its orientation, wxyz.
        object_heights: Height of each object at rest, m, if known.
        q: Joint positions, rad or m; required of a robot that takes joint commands.
    """

    ee_pos: Vector3
    ee_quat: Quaternion
    object_heights: Mapping[str, float] = field(default_factory=dict)
    q: tuple[float, ...] = ()


@dataclass(frozen=True)
class RobotSpec:
    """Description of a robot.

    It has two digests. `interface_digest` must match between a policy and a robot; `body_digest`
    is recorded, and a difference is listed for a person to accept. Neither contains unknowns of a
    real robot (mass, friction), its place (`home`) or its safeguards (`physical` and the fields
    after it).

    Attributes:
        name: Name of the robot.
        command_kinds: Kinds of command that the robot takes.
        action: Meaning and scale of a policy's action.
        control_period_s: Time of one control tick.
        frame: Frame of every pose of the robot.
        objects: Source of each object's pose, by object name.
        finger_names: Finger joints, in the order of `RobotState.fingers_pos`.
        limits: Every limit.
        gains: Gains of the low-level control, by name.
        calibration_id: Identifies the calibration in use.
        kinematic_model: MJCF text for `Kinematics` if the robot takes joint commands, else any
            text that identifies its kinematics.
        home: Pose after a reset.
        physical: Whether this is a real robot.
        hold_on_silence_s: Time without a command after which the robot holds by itself;
            a physical robot must declare it.
        enforces_joint_limits: Whether the joint limits in `limits` are enforced.
    """

    name: str
    command_kinds: tuple[str, ...]
    action: ActionSpec
    control_period_s: float
    frame: str
    objects: Mapping[str, ObjectSource]
    finger_names: tuple[str, ...]
    limits: Limits
    gains: Mapping[str, float]
    calibration_id: str
    kinematic_model: str
    home: Home
    physical: bool
    hold_on_silence_s: float | None
    enforces_joint_limits: bool

    def __post_init__(self) -> None:
        check_positive("control_period_s", self.control_period_s)
        if not self.command_kinds:
            raise InvalidSpec(
                f"{self.name} declares no command kind, allowed: at least one, such as 'joint'"
            )
        tick_m = self.limits.max_ee_speed_m_s * self.control_period_s
        for box in self.limits.keep_out:
            thinnest = min(high - low for low, high in zip(box.lower, box.upper, strict=True))
            if thinnest < tick_m < float("inf"):
                raise InvalidSpec(
                    f"a keep_out box of {self.name} is {thinnest} m thick, allowed: at least the "
                    f"{tick_m} m that the end effector moves in a tick; make it thicker"
                )
        if self.hold_on_silence_s is not None:
            check_positive("hold_on_silence_s", self.hold_on_silence_s)
        elif self.physical:
            raise InvalidSpec(
                f"{self.name} is physical and declares no hold_on_silence_s: give the time "
                "without a command after which the robot holds by itself"
            )

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joints in the order of `RobotState.q`."""
        return tuple(self.limits.joints)

    @property
    def control_period_ns(self) -> int:
        """Time of one control tick in nanoseconds."""
        return round(self.control_period_s * 1e9)

    @cached_property
    def interface_digest(self) -> str:
        """Digest of what must match between a policy and a robot."""
        return digest(self.interface())

    @cached_property
    def body_digest(self) -> str:
        """Digest of what distinguishes bodies with the same interface."""
        return digest(self.body())

    def interface(self) -> dict[str, Json]:
        """Return action meaning and scale, command kinds, control period, frames, sources."""
        return {
            "action": to_json(self.action),
            "command_kinds": to_json(tuple(sorted(self.command_kinds))),
            "control_period_s": self.control_period_s,
            "frame": self.frame,
            "objects": to_json(self.objects),
        }

    def body(self) -> dict[str, Json]:
        """Return joint names and limits, gains, calibration and kinematic model."""
        return {
            "joint_names": to_json(self.joint_names),
            "finger_names": to_json(self.finger_names),
            "limits": to_json(self.limits),
            "gains": to_json(self.gains),
            "calibration_id": self.calibration_id,
            "kinematic_model": digest(self.kinematic_model),
        }

    def interface_differences(self, other: RobotSpec) -> list[str]:
        """List the differences from another robot's interface; empty if there are none."""
        return differences(self.interface(), other.interface())

    def body_differences(self, other: RobotSpec) -> list[str]:
        """List the differences from another robot's body; empty if there are none."""
        return differences(self.body(), other.body())

    def to_dict(self) -> dict[str, Json]:
        """Return the whole description and both digests as plain JSON data."""
        whole = to_json(self)
        assert isinstance(whole, dict)
        digests: dict[str, Json] = {
            "interface_digest": self.interface_digest,
            "body_digest": self.body_digest,
        }
        return whole | digests
