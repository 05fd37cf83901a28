"""The command ``iher-robot certs``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def certs(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder to make.", show_default=False)
    ],
    host: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Name or address of the host's machine, if it is not this one; may be repeated.",
            show_default=False,
        ),
    ] = None,
    name: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ROLE_OR_USER",
            help="Client to make a certificate for, by default one for each role; may be repeated.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Make certificates for a host and its clients, for development."""
    from iher_robot.host.network.certificates import CLIENTS, HOST, make_certificates

    clients = tuple(name) if name else CLIENTS
    for path in make_certificates(folder, tuple(host or ()), clients):
        typer.echo(path)
    typer.echo(
        "For development: keys lie there without a password, and certificates end in a year.\n"
        "Bring each folder to the machine that it is for, and keep authority/ off all of them.\n"
        f"host    iher-robot serve --name fetch --listen tls/0.0.0.0:7447 --security "
        f"{folder / HOST / 'security.yaml'}\n"
        f"client  iher-robot train --task reach --robot {folder / clients[0] / 'robot.yaml'}"
    )
