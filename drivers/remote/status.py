"""The status of a robot's host: the reply to ``rpc/status``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from drivers.errors import LinkLost
from drivers.remote.client import RobotClient
from drivers.remote.messages import Empty
from drivers.validation import describe_first_problem
from drivers.wire import Count, Name, Text


def printable(text: str) -> str:
    """Replace the control characters in a text from the network, for a terminal."""
    return "".join(sign if sign.isprintable() else "\N{REPLACEMENT CHARACTER}" for sign in text)


_Name = Annotated[Name, AfterValidator(printable)]
_Text = Annotated[Text, AfterValidator(printable)]
_Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class _Answer(BaseModel):
    """Fields that a client does not know are ignored."""

    model_config = ConfigDict(
        strict=True, frozen=True, extra="ignore", use_attribute_docstrings=True
    )


class StatusFault(_Answer):
    """The latched fault."""

    name: _Name
    reason: _Text


class HostStatus(_Answer):
    """The status of a host."""

    robot: _Name
    """Name of the robot, as in its spec."""
    mode: _Name
    armed: bool
    fault: StatusFault | None
    control_period_s: _Positive
    version: _Name = ""
    """Version of the host's software, empty if the host does not report it."""
    scene: _Name = ""
    disarmed_because: _Text = ""
    """Why the host closed the gate by itself, empty if it did not."""
    holder: _Name = ""
    """The client that has the lease, empty without one."""
    refusals: Mapping[_Name, Count] = Field(default={})
    """Commands refused since the host started, by reason."""
    clips: Mapping[_Name, Count] = Field(default={})
    """Commands cut since the host started, by reason."""
    total_ticks: Mapping[_Name, Count] = Field(default={})
    """The robot's own account of control ticks, over all clients."""
    tick_late_p50_ms: float | None = None
    """How late the last ticks ended, None if the host does not measure it."""
    tick_late_p99_ms: float | None = None
    tick_overruns: Count = 0
    """Ticks since the host started that ended a whole period late."""


def read_status(client: RobotClient, timeout_s: float | None = None) -> HostStatus:
    """Request the status of a host.

    Args:
        client: Session with the host.
        timeout_s: Longest time to wait; that of the session's options by default.

    Raises:
        LinkLost: No reply in time, or one of another protocol.
    """
    reply = client.request("status", Empty(), timeout_s)
    try:
        return HostStatus.model_validate(reply.result)
    except ValidationError as error:
        raise LinkLost(
            f"the host of robot {client.options.robot!r} answers status in another protocol: "
            f"{describe_first_problem(error)}"
        ) from None
