"""The commands ``iher-robot data ls``, ``show``, ``verify`` and ``export``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from iher_robot.cli.interrupts import report_interrupts
from iher_robot.errors import UserError, unknown_name

if TYPE_CHECKING:
    from iher_robot.datasets.minari import MinariResult
    from iher_robot.datasets.parquet import ParquetResult

_DAMAGED = 1

Value = TypeVar("Value")

data = typer.Typer(name="data")

RunArgument = Annotated[
    Path, typer.Argument(metavar="RUN", help="Folder of a run.", show_default=False)
]
RunsArgument = Annotated[
    list[Path], typer.Argument(metavar="RUN", help="Folders of runs.", show_default=False)
]


@data.callback(invoke_without_command=True)
def without_a_command(context: typer.Context) -> None:
    """List, check and export the data of runs."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


@data.command()
def ls(
    folders: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="DIR",
            help="Runs, or folders of runs; runs by default.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """List runs and their data."""
    with report_interrupts(None):
        from iher_robot.datasets.api import ls as list_runs
        from iher_robot.datasets.tables import print_tables, runs_table

        lines = list_runs(folders or ())
    if not lines:
        where = ", ".join(map(str, folders or ())) or "runs"
        typer.echo(f"there is no run in {where}; iher-robot train creates one")
        return
    print_tables(runs_table(lines))


@data.command()
def show(
    run: RunArgument,
    episode: Annotated[
        int | None,
        typer.Argument(
            metavar="EPISODE",
            help="Show one episode tick by tick, from 0.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Show a summary of a run's data, or one episode."""
    with report_interrupts(None):
        from iher_robot.datasets.api import show as show_run
        from iher_robot.datasets.api import show_episode
        from iher_robot.datasets.tables import episode_table, print_tables, run_table

        if episode is None:
            print_tables(run_table(show_run(run)))
        else:
            print_tables(episode_table(show_episode(run, episode)))


@data.command()
def verify(runs: RunsArgument) -> None:
    """Check the digest of every file of runs, and that the files of each are consistent.

    Exit code 1 if something is damaged.
    """
    with report_interrupts(None):
        from iher_robot.datasets.api import verify as verify_runs

        found = verify_runs(runs)
    typer.echo(found.summary())
    if found.problems:
        raise typer.Exit(_DAMAGED)


@data.command()
def export(
    runs: RunsArgument,
    form: Annotated[str, typer.Option("--format", help="minari or parquet.", show_default=False)],
    dataset: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Name of a Minari dataset, such as push-v0.", show_default=False
        ),
    ] = None,
    root: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of Minari datasets, by default Minari's.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Parquet file to write.", show_default=False)
    ] = None,
    account: Annotated[
        str, typer.Option(help="Account of the episodes: motion, evaluation or all.")
    ] = "all",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace existing data.")] = False,
) -> None:
    """Export runs of one task to a Minari dataset or a Parquet file; needs the extra 'data'."""
    with report_interrupts(None):
        from iher_robot.datasets.api import export_minari, export_parquet

        result: MinariResult | ParquetResult
        if form == "minari":
            name = _needed(dataset, "--dataset", form)
            _refuse(form, {"--out": out})
            result = export_minari(
                runs, dataset=name, root=root, account=account, overwrite=overwrite
            )
        elif form == "parquet":
            file = _needed(out, "--out", form)
            _refuse(form, {"--dataset": dataset, "--root": root})
            result = export_parquet(runs, out=file, account=account, overwrite=overwrite)
        else:
            raise unknown_name("format", form, ("minari", "parquet"))
    typer.echo(result.summary())


def _needed(value: Value | None, option: str, form: str) -> Value:
    if value is None:
        raise UserError(f"--format {form} needs {option}; see iher-robot data export --help")
    return value


def _refuse(form: str, options: Mapping[str, object]) -> None:
    for option, value in options.items():
        if value is not None:
            raise UserError(
                f"{option} is {str(value)!r}, but --format {form} has none; leave it out"
            )
