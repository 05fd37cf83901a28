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
            help="Where to listen, tcp/127.0.0.1:7447 by default; may be repeated.",
            show_default=False,
        ),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option(
            help="The only scene to serve; by default the one that a client's task needs.",
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
        typer.Option("--insecure", help="Listen beyond this machine without any of them."),
    ] = False,
    without_joint_limits: Annotated[
        bool,
        typer.Option(
            "--without-joint-limits",
            help="Serve a robot whose joint limits nobody enforces, such as fetch-mocap.",
        ),
    ] = False,
    perception: Annotated[
        list[str] | None,
        typer.Option(
            metavar="OBJECT",
            help="Take this object's poses from another publisher; may be repeated.",
            show_default=False,
        ),
    ] = None,
    deadman: Annotated[
        float, typer.Option(help="Silence of an armed client that disarms it, s.")
    ] = 0.2,
    memory: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder that keeps latched fault, tick counter and ledger.",
            show_default=False,
        ),
    ] = None,
    tick_log: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Append a line of JSON for each control tick: what the robot did, and for whom.",
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
