"""The command ``iher-robot evaluate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from iher_robot.cli.interrupts import report_interrupts
from iher_robot.cli.options import (
    AcceptInterfaceOption,
    ConnectOption,
    DriverOption,
    PolicyTaskOption,
    RobotOption,
)


def evaluate(
    policy: Annotated[Path, typer.Argument(help="The policy.pt of a run.", show_default=False)],
    episodes: Annotated[int, typer.Option(help="Episodes to run.")] = 100,
    official: Annotated[
        bool, typer.Option("--official", help="Run in gymnasium-robotics' own environment.")
    ] = False,
    video: Annotated[
        Path | None, typer.Option(help="Write an mp4 of the episodes; needs the extra 'video'.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of starts and goals.")] = 0,
    driver: DriverOption = None,
    robot: RobotOption = None,
    connect: ConnectOption = None,
    task: PolicyTaskOption = None,
    accept_interface: AcceptInterfaceOption = False,
) -> None:
    """Measure a policy's success rate over fresh episodes."""
    with report_interrupts(None):
        from iher_robot.evaluation.evaluate import evaluate as evaluate_policy

        result = evaluate_policy(
            policy,
            episodes=episodes,
            seed=seed,
            official=official,
            driver=driver,
            robot=robot,
            connect=connect or (),
            task=task,
            video=video,
            accept_interface=accept_interface,
        )
    typer.echo(result.summary())
