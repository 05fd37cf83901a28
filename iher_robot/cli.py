"""The command line: parses, calls the application, prints. No logic lives here."""

from __future__ import annotations

import shlex
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Annotated, NoReturn

import typer

from iher_robot import DriverError, TaskError, UserError, __version__

BAD_INPUT = 2
INTERRUPTED = 130
TERMINATED = 143
_RESUMED_FROM = ("config.yaml", "ledger.sqlite")

app = typer.Typer(
    name="iher-robot",
    help="Learn manipulation from minutes of robot time, on a simulated robot or a real one.",
    add_completion=False,
    pretty_exceptions_enable=False,
)


class Terminated(KeyboardInterrupt):
    """SIGTERM arrived: whatever a Ctrl-C settles, holds and disarms, this does too."""


class _Stopped(Exception):
    """A command was interrupted; typer would turn the interrupt itself into a bare exit code."""


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"iher-robot {__version__}")
        raise typer.Exit


def _success_threshold(text: str) -> float | None:
    if text.strip().lower() == "off":
        return None
    try:
        return float(text)
    except ValueError:
        raise UserError(
            f"--until-success is {text!r}, allowed: off or a finite number, above 0 and up to 1"
        ) from None


def _folder(text: str | None, option: str) -> Path | None:
    if text is not None and not text.strip():
        raise UserError(f"{option} is {text!r}, allowed: the path of a folder")
    return None if text is None else Path(text)


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """Take the options that stand before the command."""


@app.command()
def train(
    context: typer.Context,
    task: Annotated[
        str | None, typer.Option(help="reach, push, pick-and-place or slide.", show_default=False)
    ] = None,
    driver: Annotated[str, typer.Option(help="What moves: a robot driver's name.")] = "mujoco",
    budget_minutes: Annotated[
        float | None,
        typer.Option(help="Robot minutes to spend, by default the preset's.", show_default=False),
    ] = None,
    preset: Annotated[
        str, typer.Option(help="Settings: default, paper or a YAML file.")
    ] = "default",
    algo: Annotated[str, typer.Option(help="iher, her or her-matched.")] = "iher",
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change one setting; may be repeated."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of every draw of the run.")] = 0,
    out: Annotated[
        str | None,
        typer.Option(metavar="DIR", help="Folder to make for the run, by default under runs/."),
    ] = None,
    resume: Annotated[
        str | None,
        typer.Option(
            metavar="DIR", help="Folder of a stopped run to continue, as it was configured."
        ),
    ] = None,
    until_success: Annotated[
        str, typer.Option(help="Stop when two evaluations in a row reach this rate, or off.")
    ] = "1.0",
    device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = "auto",
    display: Annotated[
        bool, typer.Option("--display/--quiet", " /--no-display", help="The live display.")
    ] = True,
) -> None:
    """Learn a task within a budget of robot minutes and leave a policy."""
    folder, stopped = _folder(out, "--out"), _folder(resume, "--resume")
    if stopped is not None:
        _refuse_settings_beside_resume(context)
        with _told_when_interrupted(stopped):
            from iher_robot.train import resume as resume_run

            result = resume_run(stopped, display=display)
        typer.echo(result.summary())
        return
    if task is None:
        raise UserError("no task given; name one with --task, or a stopped run with --resume")
    until = _success_threshold(until_success)
    with _told_when_interrupted(folder):
        from iher_robot.train import train as train_run

        result = train_run(
            task=task,
            driver=driver,
            preset=preset,
            algo=algo,
            budget_minutes=budget_minutes,
            overrides=overrides or (),
            seed=seed,
            out=folder,
            until_success=until,
            device=device,
            display=display,
        )
    typer.echo(result.summary())


@app.command()
def evaluate(
    policy: Annotated[Path, typer.Argument(help="The policy.pt of a run.", show_default=False)],
    episodes: Annotated[int, typer.Option(help="Episodes to run.")] = 100,
    official: Annotated[
        bool, typer.Option("--official", help="Run in gymnasium-robotics' own environment.")
    ] = False,
    video: Annotated[
        Path | None, typer.Option(help="Write an mp4 of the episodes; needs the extra 'video'.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of starts and goals.")] = 0,
    driver: Annotated[str, typer.Option(help="What moves: a robot driver's name.")] = "mujoco",
    task: Annotated[
        str | None,
        typer.Option(help="Refuse a policy for another task than this.", show_default=False),
    ] = None,
) -> None:
    """Measure a policy's success rate over fresh episodes."""
    with _told_when_interrupted(None):
        from iher_robot.evaluate import evaluate as evaluate_policy

        result = evaluate_policy(
            policy,
            episodes=episodes,
            seed=seed,
            official=official,
            driver=driver,
            task=task,
            video=video,
        )
    typer.echo(result.summary())


def _refuse_settings_beside_resume(context: typer.Context) -> None:
    allowed = {"resume", "display"}
    given = [
        option.opts[0]
        for option in context.command.params
        if option.name not in allowed and _is_given(context, option.name)
    ]
    if given:
        raise UserError(
            f"--resume continues a run exactly as it was configured: leave out {', '.join(given)}, "
            "or start a new run without --resume"
        )


def _is_given(context: typer.Context, name: str | None) -> bool:
    source = context.get_parameter_source(name) if name else None
    return source is not None and source.name != "DEFAULT"


@contextmanager
def _told_when_interrupted(folder: Path | None) -> Iterator[None]:
    """Say after an interrupt what is left to continue, as far as that is known.

    Args:
        folder: The run's folder, if it was named; the notes of the interrupt go first.
    """
    try:
        yield
    except KeyboardInterrupt as error:
        notes = list(getattr(error, "__notes__", ()))
        # Without settings and ledger there is nothing to resume.
        if not notes and folder and all((folder / name).is_file() for name in _RESUMED_FROM):
            notes = [f"continue with: iher-robot train --resume {shlex.quote(str(folder))}"]
        raise _Stopped("; ".join(["interrupted", *notes])) from error


@contextmanager
def _sigterm_as_interrupt() -> Iterator[None]:
    """Let SIGTERM unwind the program as Ctrl-C does, instead of ending it on the spot."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may set handlers
        return

    def terminate(number: int, frame: FrameType | None) -> NoReturn:  # noqa: ARG001
        # A second one must not cut short what settles the ledger and disarms the robot.
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        raise Terminated

    before = signal.signal(signal.SIGTERM, terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _fail(sentence: str, exit_code: int) -> NoReturn:
    typer.echo(f"iher-robot: {sentence}", err=True)
    sys.exit(exit_code)


def _exit_code(interrupt: BaseException | None) -> int:
    return TERMINATED if isinstance(interrupt, Terminated) else INTERRUPTED


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit: 0 done, 2 bad input, 130 interrupted, 143 terminated.

    Args:
        arguments: The words after the program's name; by default those of the process.

    Raises:
        SystemExit: Always, with the exit code.
    """
    words = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    try:
        with _sigterm_as_interrupt():
            code = app(args=words, prog_name="iher-robot", standalone_mode=False)
    except typer.TyperException as error:
        _fail(f"{error.format_message()} (see iher-robot --help)", BAD_INPUT)
    except (UserError, DriverError, TaskError) as error:
        _fail(str(error), BAD_INPUT)
    except _Stopped as stopped:
        _fail(str(stopped), _exit_code(stopped.__cause__))
    except KeyboardInterrupt as error:
        _fail("interrupted", _exit_code(error))
    if code == INTERRUPTED:
        _fail("interrupted", INTERRUPTED)
    sys.exit(code if isinstance(code, int) else 0)
