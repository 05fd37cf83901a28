"""Commands to the host of a robot: emergency stop and clearing a fault."""

from __future__ import annotations

import time

from drivers import (
    EMERGENCY_STOP,
    DriverError,
    InvalidSpec,
    LifecycleError,
    LinkLost,
    Mode,
)
from drivers.remote import LinkOptions
from drivers.remote.client import RobotClient
from drivers.remote.messages import ClearFaultRequest
from drivers.remote.status import HostStatus, printable, read_status
from iher_robot.config.robot import ChosenRobot
from iher_robot.config.robot_link import link_of
from iher_robot.deployment.robot_checks import latched_sentence
from iher_robot.errors import UserError

_CONNECT_S = 0.5
"""Connection timeout per endpoint of the first attempt, s; it doubles with each attempt ..."""
_MAX_CONNECT_S = 2.0
"""... up to this limit, since an interrupt has to wait for it."""
_ACKNOWLEDGE_S = 0.5
"""Longest wait for an acknowledgement before the stop is sent again, s."""
_RETRY_S = 0.1
_SETTLE_S = 0.3
"""How long to poll a stopped robot that still reports motion, s."""
_MAX_NAME_LENGTH = 200
"""Limit of the protocol."""


class NotConfirmed(UserError):
    """A stop was not acknowledged: the robot may be moving."""


def stop(robot: ChosenRobot, *, reason: str, patience_s: float) -> str:
    """Stop a robot and latch the stop; repeat until its host acknowledges.

    Args:
        robot: The robot.
        reason: Reason of the stop.
        patience_s: Time limit, connecting included, s.

    Returns:
        A sentence with the state of the robot.

    Raises:
        UserError: Bad input, or a robot without a host.
        InvalidSpec: A certificate or password file cannot be read.
        NotConfirmed: No acknowledgement within the time limit.
    """
    if not 0.0 < patience_s <= 3600.0:
        raise UserError(f"patience is {patience_s} s, allowed: above 0 and up to 3600 s")
    link = link_of(robot)
    deadline = time.monotonic() + patience_s
    text = printable(reason)
    connect_s, problem = _CONNECT_S, ""
    try:
        while (left_s := deadline - time.monotonic()) > 0:
            confirmed, answer = _stop_once(link, text, connect_s, left_s)
            if confirmed:
                return f"stopped: {answer}"
            problem = answer
            connect_s = min(2 * connect_s, _MAX_CONNECT_S)
    except KeyboardInterrupt as error:
        error.add_note(_not_confirmed(link, "when it was interrupted"))
        raise
    raise NotConfirmed(_not_confirmed(link, f"within {patience_s:g} s ({problem})"))


def clear_fault(robot: ChosenRobot, name: str) -> str:
    """Clear the latched fault of a robot. The robot stays disarmed.

    Args:
        robot: The robot.
        name: Name of the latched fault.

    Returns:
        A sentence with the result and the state of the robot.

    Raises:
        UserError: The name is empty or too long, or the robot has no host.
        LifecycleError: Another fault is latched, or none.
        LinkLost: The host does not answer, or does not allow it.
    """
    if not 0 < len(name) <= _MAX_NAME_LENGTH:
        raise UserError(
            f"name of the fault has {len(name)} characters, allowed: 1 to {_MAX_NAME_LENGTH}"
        )
    with RobotClient(link_of(robot)) as client:
        try:
            client.request("clear_fault", ClearFaultRequest(name=printable(name)))
        except LifecycleError as error:
            raise LifecycleError(printable(str(error))) from None
        return f"fault {name!r} is cleared, which does not arm the robot: {_state(client)}"


def _stop_once(link: LinkOptions, reason: str, connect_s: float, left_s: float) -> tuple[bool, str]:
    """Send a stop over a new connection: an old one may lead to a host that has ended.

    Returns:
        Whether it was acknowledged; the state of the robot, or the problem.
    """
    limits = {
        "connect_timeout_s": min(connect_s * len(link.connect), left_s),
        "timeout_s": min(link.timeout_s, _ACKNOWLEDGE_S, left_s),
    }
    problem = "no host answers"
    try:
        with RobotClient(link.model_copy(update=limits)) as client:
            problem = "its host does not answer"
            client.stop(EMERGENCY_STOP, reason, min(2 * _ACKNOWLEDGE_S, left_s))
            return True, _state(client)
    except LinkLost:
        return False, problem
    except InvalidSpec:
        raise  # a local file is wrong; a retry does not help
    except DriverError as error:
        time.sleep(min(_RETRY_S, left_s))
        return False, f"its host answers: {printable(str(error))}"


def _not_confirmed(link: LinkOptions, when: str) -> str:
    return (
        f"NOT CONFIRMED: robot {link.robot!r} at {', '.join(link.connect)} did not acknowledge "
        f"the stop {when}; it may be moving: use the robot's own emergency stop"
    )


def _state(client: RobotClient) -> str:
    """State of a robot after its host has acknowledged a command."""
    deadline = time.monotonic() + _SETTLE_S
    while True:
        try:
            status = read_status(client, _SETTLE_S)
        except DriverError as error:
            return f"acknowledged; the state of {client.options.robot!r} is not known: {error}"
        if status.mode != Mode.MOVING or time.monotonic() > deadline:
            return _sentence(status)
        time.sleep(min(_RETRY_S, status.control_period_s))


def _sentence(status: HostStatus) -> str:
    motion = "still moving" if status.mode == Mode.MOVING else "held"
    gate = "ARMED" if status.armed else "disarmed"
    state = f"{motion} and {gate}, mode {status.mode!r}"
    fault = status.fault
    if fault is None:
        return f"{status.robot} is {state}, no fault is latched"
    return f"{state}; {latched_sentence(status.robot, fault.name, fault.reason)}"
