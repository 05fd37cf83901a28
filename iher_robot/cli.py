"""The command line: parses, calls the application, prints. No logic lives here."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from iher_robot import DriverError, TaskError, UserError, __version__

BAD_INPUT = 2
INTERRUPTED = 130

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


def _success_threshold(text: str) -> float | None:
    if text == "off":
        return None
    try:
        return float(text)
    except ValueError:
        raise UserError(
            f"--until-success is {text!r}; give a success rate from 0 to 1, or 'off'"
        ) from None


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
        Path | None, typer.Option(help="Folder to make for the run, by default under runs/.")
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(help="Folder of a stopped run to continue, as it was configured."),
    ] = None,
    until_success: Annotated[
        str, typer.Option(help="Stop when two evaluations in a row reach this rate, or off.")
    ] = "1.0",
    device: Annotated[str, typer.Option(help="auto, cpu, or a torch device.")] = "auto",
    display: Annotated[
        bool, typer.Option("--display/--quiet", " /--no-display", help="The live display.")
    ] = True,
) -> None:
    """Learn a task within a budget of robot minutes and leave a policy."""
    if resume is not None:
        _refuse_settings_beside_resume(context)
        from iher_robot.train import resume as resume_run

        typer.echo(resume_run(resume, display=display).summary())
        return
    if task is None:
        raise UserError("no task given; name one with --task, or a stopped run with --resume")
    until = _success_threshold(until_success)
    from iher_robot.train import train as train_run

    result = train_run(
        task=task,
        driver=driver,
        preset=preset,
        algo=algo,
        budget_minutes=budget_minutes,
        overrides=overrides or (),
        seed=seed,
        out=out,
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


def _fail(sentence: str, exit_code: int) -> NoReturn:
    typer.echo(f"iher-robot: {sentence}", err=True)
    sys.exit(exit_code)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit: 0 done, 2 bad input, 130 interrupted.

    Args:
        arguments: The words after the program's name; by default those of the process.

    Raises:
        SystemExit: Always, with the exit code.
    """
    words = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    try:
        code = app(args=words, prog_name="iher-robot", standalone_mode=False)
    except typer.TyperException as error:
        _fail(f"{error.format_message()} (see iher-robot --help)", BAD_INPUT)
    except (UserError, DriverError, TaskError) as error:
        _fail(str(error), BAD_INPUT)
    except KeyboardInterrupt:
        code = INTERRUPTED
    if code == INTERRUPTED:
        _fail(
            "interrupted; iher-robot train --resume DIR continues a run from its folder",
            INTERRUPTED,
        )
    sys.exit(code if isinstance(code, int) else 0)
