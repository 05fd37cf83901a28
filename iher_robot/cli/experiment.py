"""The commands ``iher-robot experiment`` and ``iher-robot report``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from iher_robot.cli.interrupts import report_interrupts

_FAILED = 1


def experiment(
    manifest: Annotated[
        str,
        typer.Argument(
            metavar="NAME|FILE",
            help="A shipped experiment, such as smoke, or a YAML file.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the experiment, by default one of its name in runs/experiments; an "
            "existing one continues.",
            show_default=False,
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            help="Parallel runs on this machine, by default one per core.",
            show_default=False,
        ),
    ] = None,
    executor: Annotated[str, typer.Option(help="local or ray.")] = "local",
    address: Annotated[
        str | None,
        typer.Option(
            help="Ray cluster, such as auto or 10.0.0.7:6379; by default a new one here.",
            show_default=False,
        ),
    ] = None,
    ship: Annotated[
        bool,
        typer.Option(
            "--ship",
            help="With ray: run on the nodes' own disks and send small files back, even where they "
            "see DIR.",
        ),
    ] = False,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN",
            help="Run only cells whose names match, such as 'push-*-seed0'; may be repeated.",
            show_default=False,
        ),
    ] = None,
    display: Annotated[
        bool, typer.Option("--display/--quiet", " /--no-display", help="The live table.")
    ] = True,
) -> None:
    """Run every cell of a manifest that has not finished yet, and write the report.

    Exit code 1 if a cell did not finish, or there is no report.
    """
    with report_interrupts(None):
        from iher_robot.experiments.experiment import experiment as run_experiment

        result = run_experiment(
            manifest,
            out=out,
            executor=executor,
            workers=workers,
            address=address,
            ship=ship,
            only=only or (),
            display=display,
        )
    typer.echo(result.summary())
    if not result.complete:
        raise typer.Exit(_FAILED)


def report(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder of an experiment.", show_default=False)
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder to write to, with everything that a later report needs; the experiment's "
            "folder is not changed then. By default the same.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Write tables, figures and report of an experiment; needs the extra 'report'."""
    with report_interrupts(None):
        from iher_robot.experiments.report.report import report as make_report

        result = make_report(folder, out=out)
    typer.echo(result.summary())
