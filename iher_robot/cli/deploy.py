"""The command ``iher-robot deploy``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from iher_robot.cli.interrupts import report_interrupts
from iher_robot.cli.options import (
    AcceptInterfaceOption,
    ConnectOption,
    OwnDriverOption,
    OwnRobotOption,
    PolicyTaskOption,
)


def deploy(
    policy: Annotated[Path, typer.Argument(help="The policy.pt of a run.", show_default=False)],
    driver: OwnDriverOption = None,
    robot: OwnRobotOption = None,
    connect: ConnectOption = None,
    episodes: Annotated[int, typer.Option(help="Episodes to run.")] = 10,
    speed: Annotated[float, typer.Option(help="Share of full speed; episodes last longer.")] = 0.25,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Check and print; nothing moves.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Start without confirmation.")] = False,
    label: Annotated[
        bool, typer.Option("--label", help="Ask after each episode whether it succeeded.")
    ] = False,
    seed: Annotated[int, typer.Option(help="Seed of starts and goals.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder to create for the log, by default under deployments/.",
            show_default=False,
        ),
    ] = None,
    task: PolicyTaskOption = None,
    accept_body: Annotated[
        bool,
        typer.Option("--accept-body", help="Run a policy that was trained on another body."),
    ] = False,
    accept_interface: AcceptInterfaceOption = False,
) -> None:
    """Run a policy on a robot, after checks and a confirmation; every tick is logged."""
    with report_interrupts(None):
        from iher_robot.deployment.deploy import deploy as deploy_policy

        result = deploy_policy(
            policy,
            driver=driver,
            robot=robot,
            connect=connect or (),
            task=task,
            episodes=episodes,
            speed=speed,
            seed=seed,
            dry_run=dry_run,
            yes=yes,
            label=label,
            out=out,
            accept_body=accept_body,
            accept_interface=accept_interface,
            echo=typer.echo,
        )
    typer.echo(result.summary())
