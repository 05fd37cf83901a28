"""The command ``iher-robot serve``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from iher_robot.cli.options import DriverOption, RobotOption


def serve(
    driver: DriverOption = None,
    robot: RobotOption = None,
    name: Annotated[
        str | None,
        typer.Option(help="Name on the network; by default the robot's.", show_default=False),
    ] = None,
    listen: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ENDPOINT",
            help="Endpoint to listen on, tcp/127.0.0.1:7447 by default; may be repeated.",
            show_default=False,
        ),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option(
            help="The only scene to serve; by default that of a client's task.",
            show_default=False,
        ),
    ] = None,
    security: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Certificates, users and roles; see iher-robot certs.",
            show_default=False,
        ),
    ] = None,
    insecure: Annotated[
        bool,
        typer.Option("--insecure", help="Listen beyond this machine without security."),
    ] = False,
    without_joint_limits: Annotated[
        bool,
        typer.Option(
            "--without-joint-limits",
            help="Serve a robot that does not enforce joint limits, such as fetch-mocap.",
        ),
    ] = False,
    perception: Annotated[
        list[str] | None,
        typer.Option(
            metavar="OBJECT",
            help="Take the poses of this object from another publisher; may be repeated.",
            show_default=False,
        ),
    ] = None,
    deadman: Annotated[
        float, typer.Option(help="Silence of an armed client after which the robot is disarmed, s.")
    ] = 0.2,
    memory: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder for the latched fault, the tick counter and the ledger.",
            show_default=False,
        ),
    ] = None,
    tick_log: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Append a JSON line per control tick: the robot's state and the client.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Serve a robot to clients in other processes or on other machines, until Ctrl-C."""
    from iher_robot.host.serve import DEFAULT_LISTEN
    from iher_robot.host.serve import serve as serve_robot

    serve_robot(
        driver=driver,
        robot=robot,
        name=name,
        listen=tuple(listen) if listen else DEFAULT_LISTEN,
        scene=scene,
        security=security,
        insecure=insecure,
        without_joint_limits=without_joint_limits,
        perception=tuple(perception or ()),
        deadman_s=deadman,
        memory=memory,
        tick_log=tick_log,
        echo=typer.echo,
    )
