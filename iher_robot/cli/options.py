"""Options of several commands."""

from __future__ import annotations

from typing import Annotated

import typer

DriverOption = Annotated[
    str | None,
    typer.Option(
        help="Robot driver, by default that of the robot's file, or mujoco.",
        show_default=False,
    ),
]

RobotOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE",
        help="Robot: its name (fetch by default) or a YAML file.",
        show_default=False,
    ),
]

OwnDriverOption = Annotated[
    str | None,
    typer.Option(
        "--driver",
        help="Robot driver, by default that of the robot's file, or zenoh.",
        show_default=False,
    ),
]

OwnRobotOption = Annotated[
    str | None,
    typer.Option(
        "--robot",
        metavar="NAME|FILE",
        help="Robot: its name or a YAML file, by default robot.yaml if it exists, or fetch.",
        show_default=False,
    ),
]

PolicyTaskOption = Annotated[
    str | None,
    typer.Option("--task", help="Refuse a policy for another task than this.", show_default=False),
]

ConnectOption = Annotated[
    list[str] | None,
    typer.Option(
        "--connect",
        metavar="ENDPOINT",
        help="Endpoint of a robot of driver zenoh, such as tcp/10.0.0.7:7447; may be repeated.",
        show_default=False,
    ),
]

AcceptInterfaceOption = Annotated[
    bool,
    typer.Option(
        "--accept-interface",
        help="Run a policy that was trained for another interface; never on a physical robot.",
    ),
]
