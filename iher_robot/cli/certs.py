"""The command ``iher-robot certs``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def certs(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder to create.", show_default=False)
    ],
    host: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Name or address of the host's machine, by default this one; may be repeated.",
            show_default=False,
        ),
    ] = None,
    name: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ROLE_OR_USER",
            help="Client to create a certificate for, by default one per role; may be repeated.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Create certificates for a host and its clients, for development."""
    from iher_robot.host.network.certificates import CLIENTS, HOST, make_certificates

    clients = tuple(name) if name else CLIENTS
    for path in make_certificates(folder, tuple(host or ()), clients):
        typer.echo(path)
    typer.echo(
        "For development: keys have no password, and certificates expire after a year.\n"
        "Copy each folder to its machine; do not copy authority/ to any of them.\n"
        f"host    iher-robot serve --name fetch --listen tls/0.0.0.0:7447 --security "
        f"{folder / HOST / 'security.yaml'}\n"
        f"client  iher-robot train --task reach --robot {folder / clients[0] / 'robot.yaml'}"
    )
