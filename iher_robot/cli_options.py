"""Options that several commands take."""

from __future__ import annotations

from typing import Annotated

import typer

DriverOption = Annotated[str, typer.Option(help="What moves: a robot driver's name.")]

RobotOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE",
        help="Options of the driver: a robot's name (fetch by default) or a YAML file.",
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
