"""Bring a robot home: the application behind ``iher-robot home``."""

from __future__ import annotations

from collections.abc import Callable

from drivers import ResetOutcome, ResetRequest, RobotDriver, RobotState, StaleState
from drivers.remote.status import printable
from iher_robot.config.robot import ChosenRobot
from iher_robot.config.robot_link import make_robot
from iher_robot.deployment.description import kind_text, position_text
from iher_robot.deployment.robot_checks import (
    check_speed,
    fault_sentence,
    metres_from_home,
    require_home,
)
from iher_robot.env.operator import AskHuman, Operator, reset_with_help
from iher_robot.errors import UserError


def home(
    robot: ChosenRobot, *, speed: float, yes: bool, operator: Operator, echo: Callable[[str], None]
) -> str:
    """Bring a robot home; it is left held and disarmed.

    Args:
        robot: The robot.
        speed: Share of full speed of the way home.
        yes: Move without confirmation.
        operator: Confirms the motion and helps with the reset.
        echo: Prints a line.

    Returns:
        A sentence with its position.

    Raises:
        UserError: Bad input, no operator to confirm, or a robot that is stopped or did not reach
            home.
        DriverError: It cannot be reached, or another client holds its lease.
    """
    check_speed(speed)
    if not yes and not operator.present:
        raise UserError("there is no terminal to confirm the motion; use one, or --yes")
    with make_robot(robot) as driver:
        fault = fault_sentence(driver)
        if fault is not None:
            raise UserError(printable(fault))
        position = _position(driver, _measure(driver))
        echo(f"{driver.spec.name}, {kind_text(driver.spec)}: {position}")
        if not yes and not operator.confirms("Move it home?"):
            raise UserError("not confirmed; nothing has moved")
        driver.limit_speed(speed)
        _bring_home(driver, operator)
        state = _measure(driver)
        if state is None:
            raise UserError(
                f"{driver.spec.name} was reset, but its position is not measured; start the "
                "publisher of its objects, then run iher-robot doctor"
            )
        require_home(driver.spec, state)
        return f"{driver.spec.name} is home: {_position(driver, state)}; held and disarmed"


def _bring_home(driver: RobotDriver, operator: Operator) -> None:
    name = driver.spec.name
    try:
        result = reset_with_help(driver, ResetRequest(), _help_of(operator))
    except KeyboardInterrupt as error:
        driver.stop("interrupted on its way home")  # it would continue otherwise
        error.add_note(f"a stop was sent to {name}; check its state with: iher-robot doctor")
        raise
    if result.outcome is not ResetOutcome.DONE:
        raise UserError(
            f"{name} did not reach home: its reset ended as {result.outcome}: "
            f"{printable(result.message)}"
        )


def _help_of(operator: Operator) -> AskHuman | None:
    return (lambda message: operator.help(printable(message))) if operator.present else None


def _measure(driver: RobotDriver) -> RobotState | None:
    try:
        return driver.measure()
    except StaleState:
        return None  # a missing object pose is no reason not to go home


def _position(driver: RobotDriver, state: RobotState | None) -> str:
    if state is None:
        return "position of the end effector not measured"
    away_mm = 1e3 * metres_from_home(driver.spec, state)
    return f"end effector at {position_text(state.ee_pos)} m, {away_mm:.1f} mm from declared home"
