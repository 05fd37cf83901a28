"""The command ``iher-robot view``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from iher_robot.cli.interrupts import report_interrupts
from iher_robot.cli.options import AcceptInterfaceOption, DriverOption, RobotOption


def view(
    task: Annotated[
        str | None,
        typer.Option(help="Task to show, by default that of the policy.", show_default=False),
    ] = None,
    policy: Annotated[
        Path | None,
        typer.Option(help="Policy file; without one the robot holds still.", show_default=False),
    ] = None,
    driver: DriverOption = None,
    robot: RobotOption = None,
    seed: Annotated[int, typer.Option(help="Seed of starts and goals.")] = 0,
    episodes: Annotated[
        int | None,
        typer.Option(
            help="Episodes to show, by default until the window is closed.", show_default=False
        ),
    ] = None,
    accept_interface: AcceptInterfaceOption = False,
) -> None:
    """Show a task in MuJoCo's viewer, in real time; needs a display."""
    with report_interrupts(None):
        from iher_robot.evaluation.view import view as view_task

        result = view_task(
            task=task,
            driver=driver,
            robot=robot,
            policy=policy,
            seed=seed,
            episodes=episodes,
            accept_interface=accept_interface,
        )
    typer.echo(result.summary())
