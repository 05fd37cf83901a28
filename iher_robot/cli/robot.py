"""The commands ``iher-robot doctor``, ``home``, ``stop`` and ``clear-fault``."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from iher_robot.cli.interrupts import report_interrupts
from iher_robot.cli.options import ConnectOption, OwnDriverOption, OwnRobotOption

_FAILED = 1


def doctor(
    driver: OwnDriverOption = None,
    robot: OwnRobotOption = None,
    connect: ConnectOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, for scripts.")] = False,
) -> None:
    """Measure the link to a robot, print its specification and state, and all problems.

    Exit code 1 if there is a problem.
    """
    with report_interrupts(None):
        from iher_robot.config.robot import choose_own_robot
        from iher_robot.deployment.doctor import doctor as examine

        report = examine(choose_own_robot(driver, robot, connect or ()))
    typer.echo(json.dumps(report.to_dict(), indent=2) if as_json else report.text())
    if report.findings:
        raise typer.Exit(_FAILED)


def home(
    driver: OwnDriverOption = None,
    robot: OwnRobotOption = None,
    connect: ConnectOption = None,
    speed: Annotated[float, typer.Option(help="Share of full speed on the way home.")] = 0.25,
    yes: Annotated[bool, typer.Option("--yes", help="Move without confirmation.")] = False,
) -> None:
    """Bring a robot home; it is left held and disarmed."""
    with report_interrupts(None):
        from iher_robot.config.robot import choose_own_robot
        from iher_robot.deployment.home import home as bring_home
        from iher_robot.env.operator import Operator

        chosen = choose_own_robot(driver, robot, connect or ())
        typer.echo(bring_home(chosen, speed=speed, yes=yes, operator=Operator(), echo=typer.echo))


def stop(
    robot: OwnRobotOption = None,
    connect: ConnectOption = None,
    reason: Annotated[str, typer.Option(help="Reason of the stop.")] = "stopped by the operator",
    patience: Annotated[float, typer.Option(help="Time limit, s.")] = 5.0,
) -> None:
    """Stop a robot and latch the stop; exit code 1 if the robot did not confirm it.

    This is not a safety-rated stop.
    """
    with report_interrupts(None):
        from iher_robot.config.robot import choose_own_robot
        from iher_robot.deployment.commands import NotConfirmed
        from iher_robot.deployment.commands import stop as stop_robot

        try:
            chosen = choose_own_robot(None, robot, connect or ())
            typer.echo(stop_robot(chosen, reason=reason, patience_s=patience))
        except NotConfirmed as error:
            typer.echo(f"iher-robot: {error}", err=True)
            raise typer.Exit(_FAILED) from None


def clear_fault(
    name: Annotated[str, typer.Argument(help="Name of the latched fault.", show_default=False)],
    robot: OwnRobotOption = None,
    connect: ConnectOption = None,
) -> None:
    """Clear the latched fault of a robot by its name. The robot stays disarmed."""
    with report_interrupts(None):
        from iher_robot.config.robot import choose_own_robot
        from iher_robot.deployment.commands import clear_fault as clear

        typer.echo(clear(choose_own_robot(None, robot, connect or ()), name))
