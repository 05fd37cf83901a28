"""The command line ``iher-robot``: commands, interrupts and exit codes, without logic."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated, NoReturn

import typer

from iher_robot.cli.budget import budget
from iher_robot.cli.certs import certs
from iher_robot.cli.data import data
from iher_robot.cli.deploy import deploy
from iher_robot.cli.evaluate import evaluate
from iher_robot.cli.experiment import experiment, report
from iher_robot.cli.interrupts import Stopped
from iher_robot.cli.robot import clear_fault, doctor, home, stop
from iher_robot.cli.serve import serve
from iher_robot.cli.train import train
from iher_robot.cli.view import view
from iher_robot.errors import UserError
from iher_robot.signals import Terminated, sigterm_as_interrupt
from iher_robot.version import __version__

BAD_INPUT = 2
INTERRUPTED = 130
TERMINATED = 143

app = typer.Typer(
    name="iher-robot",
    help="Learn manipulation from minutes of robot time, on a simulated robot or a real one.",
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"iher-robot {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """Options before the command."""


_LEARN = (train, evaluate, experiment, report, view)
_OPERATE = (serve, deploy, doctor, home, stop, clear_fault, certs)
for _command in (*_LEARN, *_OPERATE):
    app.command()(_command)
app.add_typer(data)
app.add_typer(budget)


def _fail(sentence: str, exit_code: int) -> NoReturn:
    typer.echo(f"iher-robot: {sentence}", err=True)
    sys.exit(exit_code)


def _user_errors() -> tuple[type[Exception], ...]:
    # Imported only when something was raised: both load numpy.
    from drivers import DriverError
    from tasks import TaskError

    return UserError, DriverError, TaskError


def _exit_code(interrupt: BaseException | None) -> int:
    return TERMINATED if isinstance(interrupt, Terminated) else INTERRUPTED


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit: 0 done, 2 bad input, 130 interrupted, 143 terminated.

    Args:
        arguments: The arguments after the program's name; by default those of the process.

    Raises:
        SystemExit: Always, with the exit code.
    """
    args = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    try:
        with sigterm_as_interrupt():
            code = app(args=args, prog_name="iher-robot", standalone_mode=False)
    except typer.TyperException as error:
        _fail(f"{error.format_message()} (see iher-robot --help)", BAD_INPUT)
    except Stopped as stopped:
        _fail(str(stopped), _exit_code(stopped.__cause__))
    except KeyboardInterrupt as error:
        _fail("interrupted", _exit_code(error))
    except _user_errors() as error:
        _fail(str(error), BAD_INPUT)
    if code == INTERRUPTED:
        _fail("interrupted", INTERRUPTED)
    sys.exit(code if isinstance(code, int) else 0)
