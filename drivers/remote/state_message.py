"""The message that publishes a robot's state in every tick."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from drivers.gate import Fault
from drivers.remote.messages import POSE_SIZES, check_command, command_fields
from drivers.spec import RobotSpec
from drivers.state import AppliedCommand, JointSetpoint, Mode, ObjectPose, RobotState
from drivers.wire import (
    VERSION,
    Array,
    Count,
    Message,
    Name,
    Part,
    Text,
    WireError,
    pack,
    unpack,
)

_ARRAYS = ("q", "dq", "ee_pos", "ee_quat", "ee_linvel", "ee_angvel", "fingers_pos", "fingers_vel")


@dataclass(frozen=True)
class HostInfo:
    """Status of a host, published with the robot's state.

    Attributes:
        boot: Identifies this start of the host.
        token: The lease in force, 0 for none.
        n: Number of the last command of that lease that was processed before the tick ended.
        now_ns: Time of sending, on the clock of the stamps.
        armed: Whether the command gate is open.
        disarmed_because: Why the host closed the gate by itself, empty if it did not.
        fault: The latched fault.
        refusals: Commands refused since the host started, by reason.
        clips: Commands cut since the host started, by reason.
    """

    boot: str
    token: int
    n: int
    now_ns: int
    armed: bool
    disarmed_because: str
    fault: Fault | None
    refusals: Mapping[str, int]
    clips: Mapping[str, int]


class FaultPart(Part):
    """A latched fault."""

    name: Name
    reason: Text
    stamp_ns: int


class AppliedPart(Part):
    """The command applied last; `command` has the form of a command message."""

    tick: Count
    clipped: list[Name]
    command: dict[str, Any]


class SetpointPart(Part):
    """Target of the motors."""

    q: Array
    dq: Array
    fingers: Array


class ObjectPart(Part):
    """Pose of an object as measured by one sensor."""

    pos: Array
    quat: Array
    linvel: Array
    angvel: Array
    stamp_ns: int
    source: Name
    frame: Name


class StateMessage(Message):
    """A `RobotState` and a `HostInfo`."""

    boot: Name
    token: Count
    n: Count
    now_ns: int
    armed: bool
    disarmed_because: Text
    fault: FaultPart | None
    refusals: dict[Name, Count]
    clips: dict[Name, Count]
    seq: Count
    stamp_ns: int
    mode: Name
    q: Array
    dq: Array
    ee_pos: Array
    ee_quat: Array
    ee_linvel: Array
    ee_angvel: Array
    fingers_pos: Array
    fingers_vel: Array
    applied: AppliedPart | None
    setpoint: SetpointPart | None
    objects: dict[Name, ObjectPart]


def pack_state(state: RobotState, info: HostInfo) -> bytes:
    """Encode a state.

    Args:
        state: The robot's state.
        info: The host's status.
    """
    applied, setpoint = state.applied, state.setpoint
    content: dict[str, Any] = {name: getattr(state, name) for name in _ARRAYS}
    content |= {
        "v": VERSION,
        "boot": info.boot,
        "token": info.token,
        "n": info.n,
        "now_ns": info.now_ns,
        "armed": info.armed,
        "disarmed_because": info.disarmed_because,
        "fault": None if info.fault is None else vars(info.fault),
        "refusals": dict(info.refusals),
        "clips": dict(info.clips),
        "seq": state.seq,
        "stamp_ns": state.stamp_ns,
        "mode": str(state.mode),
        "applied": None if applied is None else _applied(applied),
        "setpoint": None if setpoint is None else vars(setpoint),
        "objects": {name: vars(pose) for name, pose in state.objects.items()},
    }
    return pack(content)


def unpack_state(data: bytes, spec: RobotSpec, received_ns: int) -> tuple[RobotState, HostInfo]:
    """Decode and check a state.

    Args:
        data: The packed state.
        spec: The robot; its numbers of joints and fingers, and its objects, are checked.
        received_ns: Time of receipt, on the receiver's clock. Every stamp is converted to that
            clock by its age at the time of sending; the unknown transit time is left out.

    Raises:
        WireError: It is malformed, or of another robot.
    """
    message = unpack(StateMessage, data)
    _check_shapes(message, spec)
    shift_ns = received_ns - message.now_ns
    applied, setpoint, fault = message.applied, message.setpoint, message.fault
    state = RobotState(
        seq=message.seq,
        stamp_ns=message.stamp_ns + shift_ns,
        **{name: getattr(message, name) for name in _ARRAYS},
        mode=_mode(message.mode),
        fault=None if fault is None else fault.name,
        applied=None if applied is None else _read_applied(applied),
        setpoint=None
        if setpoint is None
        else JointSetpoint(setpoint.q, setpoint.dq, setpoint.fingers),
        objects={
            name: ObjectPose(
                pos=pose.pos,
                quat=pose.quat,
                linvel=pose.linvel,
                angvel=pose.angvel,
                stamp_ns=pose.stamp_ns + shift_ns,
                source=pose.source,
                frame=pose.frame,
            )
            for name, pose in message.objects.items()
        },
    )
    info = HostInfo(
        boot=message.boot,
        token=message.token,
        n=message.n,
        now_ns=message.now_ns,
        armed=message.armed,
        disarmed_because=message.disarmed_because,
        fault=None if fault is None else Fault(fault.name, fault.reason, fault.stamp_ns),
        refusals=message.refusals,
        clips=message.clips,
    )
    return state, info


def _applied(applied: AppliedCommand) -> dict[str, Any]:
    command = applied.command
    message = {"v": VERSION, "boot": "", "token": 0, "n": 0, "answers": command.answers}
    return {
        "tick": applied.tick,
        "clipped": [str(reason) for reason in applied.clipped],
        "command": message | command_fields(command),
    }


def _read_applied(part: AppliedPart) -> AppliedCommand:
    message = check_command(part.command)
    command = message.command(message.answers)
    if command is None:
        raise WireError("malformed", "the applied command is a hold, allowed: joint, ee_delta")
    return AppliedCommand(part.tick, command, tuple(part.clipped))


def _mode(name: str) -> Mode:
    try:
        return Mode(name)
    except ValueError:
        raise WireError("malformed", f"mode is {name!r:.40}, allowed: {', '.join(Mode)}") from None


def _check_shapes(message: StateMessage, spec: RobotSpec) -> None:
    joints, fingers = len(spec.joint_names), len(spec.finger_names)
    sizes = dict(zip(_ARRAYS, (joints, joints, 3, 4, 3, 3, fingers, fingers), strict=True))
    found = {name: getattr(message, name) for name in _ARRAYS}
    if message.setpoint is not None:
        found |= {f"setpoint.{name}": value for name, value in vars(message.setpoint).items()}
        sizes |= {"setpoint.q": joints, "setpoint.dq": joints, "setpoint.fingers": fingers}
    for name, pose in message.objects.items():
        for field, size in POSE_SIZES.items():
            found[f"{name}.{field}"], sizes[f"{name}.{field}"] = getattr(pose, field), size
    unknown = message.objects.keys() - spec.objects.keys()
    if unknown:
        raise WireError("malformed", f"objects {sorted(unknown)}, allowed: {sorted(spec.objects)}")
    for name, array in found.items():
        if array.shape != (sizes[name],):
            raise WireError(
                "malformed", f"{name} has shape {array.shape}, allowed: ({sizes[name]},)"
            )
