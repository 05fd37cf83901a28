"""What an operator does with a robot: stop it, clear a fault, bring it home."""

from __future__ import annotations

import time
from collections.abc import Callable

from drivers import (
    EMERGENCY_STOP,
    DriverError,
    InvalidSpec,
    LifecycleError,
    LinkLost,
    Mode,
    ResetOutcome,
    ResetRequest,
    RobotDriver,
    RobotState,
    StaleState,
)
from drivers.remote import LinkOptions
from drivers.remote.client import RobotClient
from drivers.remote.messages import ClearFaultRequest
from drivers.remote.status import HostStatus, printable, read_status
from iher_robot.config.robot import ChosenRobot
from iher_robot.config.robot_link import link_of, make_robot
from iher_robot.deployment.robot_checks import latched_sentence, metres_from_home, require_home
from iher_robot.env.operator import AskHuman, Operator, reset_with_help
from iher_robot.errors import UserError

_CONNECT_S = 0.5
"""Longest wait for one endpoint at the first attempt to connect; it doubles with each ..."""
_CONNECT_MOST_S = 2.0
"""... up to this: an interrupt waits for it."""
_ANSWER_S = 0.5
"""Longest wait for one acknowledgement before the stop is sent again."""
_AGAIN_S = 0.1
_SETTLE_S = 0.3
"""How long a stopped robot is asked again while it still says that it moves."""
_NAME_LENGTH = 200
"""What a message takes."""


class NotConfirmed(UserError):
    """A stop was not acknowledged: the robot may be moving."""


def stop(robot: ChosenRobot, *, reason: str, patience_s: float) -> str:
    """Stop a robot and latch, again and again until its host acknowledges.

    Args:
        robot: The robot.
        reason: What happened, in words.
        patience_s: How long to try, also to connect, s.

    Returns:
        How it stands, in words.

    Raises:
        UserError: Bad input, or a robot without a host.
        InvalidSpec: A file of certificates or the password cannot be read.
        NotConfirmed: No acknowledgement in that time.
    """
    if not 0.0 < patience_s <= 3600.0:
        raise UserError(f"patience is {patience_s} s, allowed: above 0 and up to 3600 s")
    link = link_of(robot)
    deadline = time.monotonic() + patience_s
    told = printable(reason)
    connect_s, problem = _CONNECT_S, ""
    try:
        while (left_s := deadline - time.monotonic()) > 0:
            confirmed, problem = _stop_once(link, told, connect_s, left_s)
            if confirmed:
                return f"stopped: {problem}"
            connect_s = min(2 * connect_s, _CONNECT_MOST_S)
    except KeyboardInterrupt as error:
        error.add_note(_not_confirmed(link, "when it was interrupted"))
        raise
    raise NotConfirmed(_not_confirmed(link, f"within {patience_s:g} s ({problem})"))


def clear_fault(robot: ChosenRobot, name: str) -> str:
    """Unlatch the fault of a robot. It never arms.

    Args:
        robot: The robot.
        name: Name of the latched fault.

    Returns:
        What was done and how the robot stands, in words.

    Raises:
        UserError: No name of a fault, or a robot without a host.
        LifecycleError: Another fault is latched, or none.
        LinkLost: The host does not answer, or does not allow it.
    """
    if not 0 < len(name) <= _NAME_LENGTH:
        raise UserError(f"name of the fault has {len(name)} letters, allowed: 1 to {_NAME_LENGTH}")
    with RobotClient(link_of(robot)) as client:
        try:
            client.request("clear_fault", ClearFaultRequest(name=printable(name)))
        except LifecycleError as error:
            raise LifecycleError(printable(str(error))) from None
        return f"fault {name!r} is cleared, which never arms: {_standing(client)}"


def home(
    robot: ChosenRobot, *, speed: float, yes: bool, operator: Operator, echo: Callable[[str], None]
) -> str:
    """Bring a robot home; it is left held and disarmed.

    Args:
        robot: The robot.
        speed: Share of full speed of the way home.
        yes: Move without a question.
        operator: Asked before it moves, and for help.
        echo: Prints a line.

    Returns:
        Where it stands, in words.

    Raises:
        UserError: Bad input, nobody to ask, or a robot that is stopped or did not get there.
        DriverError: It cannot be reached, or somebody else has it.
    """
    if not 0.0 < speed <= 1.0:
        raise UserError(f"speed is {speed}, allowed: above 0 and up to 1, a share of full speed")
    if not yes and not operator.present:
        raise UserError("there is no terminal to ask whether to move; use one, or --yes")
    with make_robot(robot) as driver:
        fault = driver.fault
        if fault is not None:
            raise UserError(printable(latched_sentence(driver.spec.name, fault.name, fault.reason)))
        kind = "PHYSICAL, it will really move" if driver.spec.physical else "simulated"
        echo(f"{driver.spec.name}, {kind}: {_place(driver, _measured(driver))}")
        if not yes and not operator.confirms("Move it home?"):
            raise UserError("not confirmed; nothing has moved")
        driver.limit_speed(speed)
        _bring_home(driver, operator)
        state = _measured(driver)
        if state is None:
            raise UserError(
                f"{driver.spec.name} was reset, and where it stands is not measured; start what "
                "publishes its objects, and see: iher-robot doctor"
            )
        require_home(driver.spec, state)
        return f"{driver.spec.name} is home: {_place(driver, state)}; held and disarmed"


def _stop_once(link: LinkOptions, reason: str, connect_s: float, left_s: float) -> tuple[bool, str]:
    """Try to stop over a connection of its own: an old one may lead to a host that is no more."""
    limits = {
        "connect_timeout_s": min(connect_s * len(link.connect), left_s),
        "timeout_s": min(link.timeout_s, _ANSWER_S, left_s),
    }
    problem = "nobody answers there"
    try:
        with RobotClient(link.model_copy(update=limits)) as client:
            problem = "its host does not answer"
            client.stop(EMERGENCY_STOP, reason, min(2 * _ANSWER_S, left_s))
            return True, _standing(client)
    except LinkLost:
        return False, problem
    except InvalidSpec:
        raise  # a file here is wrong; trying again does not help
    except DriverError as error:
        time.sleep(min(_AGAIN_S, left_s))
        return False, f"its host answers: {printable(str(error))}"


def _not_confirmed(link: LinkOptions, when: str) -> str:
    return (
        f"NOT CONFIRMED: robot {link.robot!r} at {', '.join(link.connect)} did not acknowledge "
        f"the stop {when}; it may be moving: use the robot's own emergency stop"
    )


def _standing(client: RobotClient) -> str:
    """Say how a robot stands after what its host has acknowledged."""
    deadline = time.monotonic() + _SETTLE_S
    while True:
        try:
            status = read_status(client, _SETTLE_S)
        except DriverError as error:
            return f"acknowledged; how {client.options.robot!r} stands is not known: {error}"
        if status.mode != Mode.MOVING or time.monotonic() > deadline:
            return _sentence(status)
        time.sleep(min(_AGAIN_S, status.control_period_s))


def _sentence(status: HostStatus) -> str:
    motion = "still moving" if status.mode == Mode.MOVING else "held"
    gate = "ARMED" if status.armed else "disarmed"
    stands = f"{motion} and {gate}, mode {status.mode!r}"
    fault = status.fault
    if fault is None:
        return f"{status.robot} is {stands}, no fault is latched"
    return f"{stands}; {latched_sentence(status.robot, fault.name, fault.reason)}"


def _bring_home(driver: RobotDriver, operator: Operator) -> None:
    name = driver.spec.name
    try:
        result = reset_with_help(driver, ResetRequest(), _help_of(operator))
    except KeyboardInterrupt as error:
        driver.stop("interrupted on its way home")  # else it would go on by itself
        error.add_note(f"a stop was sent to {name}; see how it stands with: iher-robot doctor")
        raise
    if result.outcome is not ResetOutcome.DONE:
        raise UserError(
            f"{name} did not get home: its reset ended as {result.outcome}: "
            f"{printable(result.message)}"
        )


def _help_of(operator: Operator) -> AskHuman | None:
    return (lambda message: operator.help(printable(message))) if operator.present else None


def _measured(driver: RobotDriver) -> RobotState | None:
    try:
        return driver.measure()
    except StaleState:
        return None  # an object that nobody has seen yet is no reason not to go home


def _place(driver: RobotDriver, state: RobotState | None) -> str:
    if state is None:
        return "where its end effector is, is not measured"
    place = ", ".join(f"{value:.3f}" for value in state.ee_pos)
    away_mm = 1e3 * metres_from_home(driver.spec, state)
    return f"end effector at {place} m, {away_mm:.1f} mm from its declared home"
