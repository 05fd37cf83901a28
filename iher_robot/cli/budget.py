"""The commands ``iher-robot budget show`` and ``grant``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from iher_robot.cli.interrupts import report_interrupts
from iher_robot.cli.options import ConnectOption, OwnRobotOption
from iher_robot.errors import UserError

if TYPE_CHECKING:
    from iher_robot.datasets.spending import Spending

budget = typer.Typer(name="budget")


@budget.callback(invoke_without_command=True)
def without_a_command(context: typer.Context) -> None:
    """Show the robot time spent, and grant more."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


@budget.command()
def show(
    run: Annotated[
        Path | None,
        typer.Argument(metavar="[RUN]", help="Folder of a run.", show_default=False),
    ] = None,
    robot: OwnRobotOption = None,
    connect: ConnectOption = None,
) -> None:
    """Show spent and remaining robot time of a run; without a run, the total of a served robot."""
    with report_interrupts(None):
        from iher_robot.config.robot import choose_own_robot
        from iher_robot.datasets.spending import spending_of_robot, spending_of_run

        if run is None:
            _print(spending_of_robot(choose_own_robot(None, robot, connect or ())))
        elif robot is None and not connect:
            _print(spending_of_run(run))
        else:
            raise UserError(f"give a run ({run}), or a robot with --robot and --connect, not both")


@budget.command()
def grant(
    run: Annotated[Path, typer.Argument(help="Folder of a run.", show_default=False)],
    minutes: Annotated[float, typer.Argument(help="Robot minutes of motion.", show_default=False)],
) -> None:
    """Grant a run more robot minutes; train --resume continues with them."""
    with report_interrupts(None):
        from iher_robot.datasets.spending import grant as grant_minutes

        _print(grant_minutes(run, minutes))


def _print(spending: Spending) -> None:
    from iher_robot.datasets.tables import print_tables, spending_table

    print_tables(spending_table(spending))
