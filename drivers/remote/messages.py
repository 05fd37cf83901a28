"""Commands, requests and replies between a host and its clients; see ``docs/protocol.md``."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from drivers.command import Command, EndEffectorCommand, JointCommand
from drivers.wire import Array, Count, Message, Name, Text, WireError, check, unpack_map

FAULT_NAME = r"^[a-z0-9][a-z0-9_-]{0,63}$"
"""Names that an operator can type."""

FaultName = Annotated[str, Field(pattern=FAULT_NAME)]
Speed = Annotated[float, Field(gt=0, le=1)]
Time = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]


class CommandMessage(Message):
    """Fields of every command. By itself a hold: a heartbeat without motion in this tick."""

    kind: Literal["hold", "joint", "ee_delta"] = "hold"
    boot: Name
    """Identifies the start of the host that the client is connected to."""
    token: Count
    """The lease under which it is sent."""
    n: Count
    """Increases with every command of a lease."""
    answers: Count
    """Sequence of the state that the command was computed from."""

    def command(self, answers: int) -> Command | None:  # noqa: ARG002 - a hold has none
        """Return the command for the driver, None for no motion.

        Args:
            answers: Sequence of the state in the driver's tick counter.
        """
        return None


class JointMessage(CommandMessage):
    """A `JointCommand`."""

    kind: Literal["joint"] = "joint"
    q_target: Array
    dq: Array
    duration_s: float
    finger_target: Array

    def command(self, answers: int) -> Command:
        """Return the joint command."""
        return JointCommand(answers, self.q_target, self.dq, self.duration_s, self.finger_target)


class EndEffectorMessage(CommandMessage):
    """An `EndEffectorCommand`."""

    kind: Literal["ee_delta"] = "ee_delta"
    delta_pos: Array
    finger_delta: Array

    def command(self, answers: int) -> Command:
        """Return the displacement."""
        return EndEffectorCommand(answers, self.delta_pos, self.finger_delta)


_KINDS: dict[object, type[CommandMessage]] = {
    "hold": CommandMessage,
    "joint": JointMessage,
    "ee_delta": EndEffectorMessage,
}


def unpack_command(data: bytes) -> CommandMessage:
    """Decode and check a command.

    Raises:
        WireError: It is malformed, or of another version.
    """
    return check_command(unpack_map(data))


def check_command(content: Mapping[str, object]) -> CommandMessage:
    """Check a decoded command.

    Raises:
        WireError: It is malformed.
    """
    kind = content.get("kind")
    if not isinstance(kind, str) or kind not in _KINDS:
        raise WireError(
            "malformed", f"kind is {reprlib.repr(kind):.40}, allowed: {', '.join(map(str, _KINDS))}"
        )
    return check(_KINDS[kind], content)


def command_fields(command: Command | None) -> dict[str, Any]:
    """Return the fields that a command adds to a `CommandMessage`; None is a hold.

    Raises:
        TypeError: If the protocol has no such kind of command.
    """
    if command is None:
        return {"kind": "hold"}
    names: tuple[str, ...]
    if isinstance(command, JointCommand):
        names = ("q_target", "dq", "duration_s", "finger_target")
    elif isinstance(command, EndEffectorCommand):
        names = ("delta_pos", "finger_delta")
    else:
        raise TypeError(
            f"kind of command is {command.kind!r}, allowed for a remote robot: joint, ee_delta"
        )
    return {"kind": command.kind} | {name: getattr(command, name) for name in names}


POSE_SIZES = {"pos": 3, "quat": 4, "linvel": 3, "angvel": 3}
"""Length of each array in the pose of an object."""


class ObjectMessage(Message):
    """The pose of an object, from another publisher than the robot."""

    n: Count
    """Increases with every pose of this publisher."""
    age_s: Time
    """Time from the measurement to the sending of this message."""
    frame: Name
    pos: Array
    quat: Array
    linvel: Array
    angvel: Array


# Requests of clients under rpc/NAME, and the reply


class Empty(Message):
    """A request without content: `spec` of the current scene, `status`."""


class SpecRequest(Message):
    """Request for the robot's description."""

    scene: Name | None = None
    """The scene; None for the current one."""


class Ping(Message):
    """Request that the host answers with the same payload."""

    payload: Annotated[bytes, Field(max_length=65536)] = b""


class LeaseRequest(Message):
    """Request to acquire, renew or release the lease."""

    op: Literal["acquire", "renew", "release"]
    session: Name
    """Random identifier of a client, which may acquire its own lease again."""
    holder: Name
    """Description of the client for people: user, machine, process."""
    token: Count = 0
    """The lease to renew or release."""
    scene: Name | None = None
    """The scene that the task needs; None for the current one."""


class Leased(Message):
    """A request that requires the lease: `disarm`, `hands_clear`."""

    boot: Name
    token: Count


class ArmRequest(Leased):
    """Request to open the command gate."""

    speed: Speed = 1.0
    """Share of full speed."""


class ResetMessage(Leased):
    """A `ResetRequest`."""

    objects: dict[Name, list[float]]
    seed: Count
    speed: Speed = 1.0
    """Share of full speed on the way home."""


class StopRequest(Message):
    """Request to stop and latch, open to every client."""

    fault: FaultName
    reason: Text


class ClearFaultRequest(Message):
    """Request to unlatch a fault, on behalf of an operator. Never arms."""

    name: Name


class Reply(Message):
    """The reply to every request."""

    ok: bool
    error: Name = ""
    """Type of the error, as in `drivers.errors`."""
    message: Text = ""
    boot: Name
    seq: Count
    """The robot's tick counter at the time of the reply."""
    result: dict[str, Any] = Field(default={})
    """Content of the reply, by request."""
