"""What travels between a host and its clients, apart from states; see ``docs/protocol.md``."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from drivers.command import Command, EndEffectorCommand, JointCommand
from drivers.wire import Array, Count, Message, Name, Text, WireError, check, unpack_map

FAULT_NAME = r"^[a-z0-9][a-z0-9_-]{0,63}$"
"""An operator must be able to type it."""

FaultName = Annotated[str, Field(pattern=FAULT_NAME)]
Speed = Annotated[float, Field(gt=0, le=1)]
Time = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]


class CommandMessage(Message):
    """What every command says. By itself: the client is there and wants no motion in this tick."""

    kind: Literal["hold", "joint", "ee_delta"] = "hold"
    boot: Name
    """Which start of the host the client means."""
    token: Count
    """The lease under which it is sent."""
    n: Count
    """Rises with every command of a lease."""
    answers: Count
    """Sequence of the state that the client had seen."""

    def command(self, answers: int) -> Command | None:  # noqa: ARG002 - by itself it has none
        """Return what the robot is asked for, None for no motion.

        Args:
            answers: Sequence of the state, as the driver counts.
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
        WireError: It is none.
    """
    return check_command(unpack_map(data))


def check_command(content: Mapping[str, object]) -> CommandMessage:
    """Check a decoded command.

    Raises:
        WireError: It is none.
    """
    kind = content.get("kind")
    if not isinstance(kind, str) or kind not in _KINDS:
        raise WireError(
            "malformed", f"kind is {reprlib.repr(kind):.40}, allowed: {', '.join(map(str, _KINDS))}"
        )
    return check(_KINDS[kind], content)


def command_fields(command: Command | None) -> dict[str, Any]:
    """Return what a command adds to a `CommandMessage`; of None nothing.

    Raises:
        TypeError: If the protocol has no such command.
    """
    if command is None:
        return {"kind": "hold"}
    names: tuple[str, ...]
    if isinstance(command, JointCommand):
        names = ("q_target", "dq", "duration_s", "finger_target")
    elif isinstance(command, EndEffectorCommand):
        names = ("delta_pos", "finger_delta")
    else:
        raise TypeError(f"{command.kind!r} commands cannot be sent to a remote robot")
    return {"kind": command.kind} | {name: getattr(command, name) for name in names}


POSE_SIZES = {"pos": 3, "quat": 4, "linvel": 3, "angvel": 3}
"""Length of each array in the pose of an object."""


class ObjectMessage(Message):
    """The pose of an object, as somebody else than the robot saw it."""

    n: Count
    """Rises with every pose of this publisher."""
    age_s: Time
    """Time from the picture to the sending of this message."""
    frame: Name
    pos: Array
    quat: Array
    linvel: Array
    angvel: Array


# Requests: what a client asks under rpc/NAME, and what it is answered


class Empty(Message):
    """A request without content: `spec` of the scene in force, `status`."""


class SpecRequest(Message):
    """Describe the robot."""

    scene: Name | None = None
    """In this scene; None for the one in force."""


class Ping(Message):
    """Answer at once."""

    payload: Annotated[bytes, Field(max_length=65536)] = b""


class LeaseRequest(Message):
    """Ask for the right to command, keep it, or give it back."""

    op: Literal["acquire", "renew", "release"]
    session: Name
    """Drawn by chance by each client; it may take over its own lease."""
    holder: Name
    """Who it is, for people: user, machine, process."""
    token: Count = 0
    """The lease to renew or release."""
    scene: Name | None = None
    """The scene that the task needs; None for the one in force."""


class Leased(Message):
    """A request of whoever has the lease: `disarm`, `hands_clear`."""

    boot: Name
    token: Count


class ArmRequest(Leased):
    """Open the command gate."""

    speed: Speed = 1.0
    """Share of full speed."""


class ResetMessage(Leased):
    """A `ResetRequest`."""

    objects: dict[Name, list[float]]
    seed: Count
    speed: Speed = 1.0
    """Share of full speed of the way home."""


class StopRequest(Message):
    """Stop and latch. Anybody may."""

    fault: FaultName
    reason: Text


class ClearFaultRequest(Message):
    """Unlatch a fault: an operator's act. It never arms."""

    name: Name


class Reply(Message):
    """The answer to every request."""

    ok: bool
    error: Name = ""
    """Type of the error, as in `drivers.errors`."""
    message: Text = ""
    boot: Name
    seq: Count
    """The robot's tick counter when it was answered."""
    result: dict[str, Any] = Field(default={})
    """What was asked for."""
