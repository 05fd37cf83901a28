"""The command ``iher-robot train``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from iher_robot.cli.interrupts import report_interrupts
from iher_robot.cli.options import ConnectOption, DriverOption, RobotOption
from iher_robot.errors import UserError
from iher_robot.training.learners.torchrun import read_torchrun_rank

if TYPE_CHECKING:
    from iher_robot.training.result import TrainResult

_ALLOWED_WITH_RESUME = {"resume", "display", "simulators", "video"}
_ALLOWED_WITH_CONFIG = {"config", "out", "display", "simulators", "video"}


def train(
    context: typer.Context,
    task: Annotated[
        str | None, typer.Option(help="reach, push, pick-and-place or slide.", show_default=False)
    ] = None,
    driver: DriverOption = None,
    robot: RobotOption = None,
    connect: ConnectOption = None,
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
    seed: Annotated[int, typer.Option(help="Seed of all random numbers of the run.")] = 0,
    out: Annotated[
        str | None,
        typer.Option(metavar="DIR", help="Folder to create for the run, by default under runs/."),
    ] = None,
    resume: Annotated[
        str | None,
        typer.Option(metavar="DIR", help="Folder of a stopped run to continue, with its settings."),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="File with all settings of the run, such as the config.yaml of another run.",
            show_default=False,
        ),
    ] = None,
    from_data: Annotated[
        list[str] | None,
        typer.Option(
            metavar="DIR",
            help="Start with the real episodes of an earlier run; may be repeated.",
            show_default=False,
        ),
    ] = None,
    until_success: Annotated[
        str, typer.Option(help="Stop when two evaluations in a row reach this rate, or off.")
    ] = "1.0",
    device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = "auto",
    asynchronous: Annotated[
        bool | None,
        typer.Option(
            "--async/--sync",
            help="Learn in another process while the robot moves, or in turn with it.",
            show_default=False,
        ),
    ] = None,
    simulators: Annotated[
        int | None,
        typer.Option(
            help="Number of parallel simulated robots, one core each.", show_default=False
        ),
    ] = None,
    video: Annotated[
        bool, typer.Option("--video", help="Film the final policy; needs the extra 'video'.")
    ] = False,
    display: Annotated[
        bool, typer.Option("--display/--quiet", " /--no-display", help="The live display.")
    ] = True,
) -> None:
    """Learn a task within a budget of robot minutes; writes a policy."""
    rank = read_torchrun_rank()
    if rank is not None and rank.rank:
        from iher_robot.training.learners.distributed_worker import main as learn_with_others

        learn_with_others(rank)
        return
    folder, stopped = _folder(out, "--out"), _folder(resume, "--resume")
    if stopped is not None:
        _refuse_other_settings(context, "--resume", _ALLOWED_WITH_RESUME)
        result = _resume(stopped, simulators=simulators, display=display, video=video)
    elif config is not None:
        _refuse_other_settings(context, "--config", _ALLOWED_WITH_CONFIG)
        result = _train_config(config, folder, simulators=simulators, display=display, video=video)
    elif task is None:
        raise UserError("no task given; choose one with --task, or a stopped run with --resume")
    else:
        until = _success_threshold(until_success)
        with report_interrupts(folder):
            from iher_robot.training.train import train as train_run

            result = train_run(
                task=task,
                driver=driver,
                robot=robot,
                connect=connect or (),
                preset=preset,
                algo=algo,
                budget_minutes=budget_minutes,
                overrides=overrides or (),
                seed=seed,
                out=folder,
                until_success=until,
                device=device,
                asynchronous=asynchronous,
                simulators=simulators,
                display=display,
                video=video,
                from_data=from_data or (),
            )
    typer.echo(result.summary())


def _resume(folder: Path, *, simulators: int | None, display: bool, video: bool) -> TrainResult:
    with report_interrupts(folder):
        from iher_robot.training.train import resume

        return resume(folder, simulators=simulators, display=display, video=video)


def _train_config(
    config: Path, folder: Path | None, *, simulators: int | None, display: bool, video: bool
) -> TrainResult:
    with report_interrupts(folder):
        from iher_robot.config.run import change_simulators, read_config
        from iher_robot.training.train import train

        settings = read_config(config)
        if simulators is not None:
            settings = change_simulators(settings, simulators)
        return train(settings, out=folder, display=display, video=video)


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


_REASONS = {
    "--resume": "continues a run with its own settings",
    "--config": "gives all settings of a run",
}


def _refuse_other_settings(context: typer.Context, option: str, allowed: set[str]) -> None:
    given = [
        other.opts[0]
        for other in context.command.params
        if other.name not in allowed and _is_given(context, other.name)
    ]
    if given:
        raise UserError(
            f"{option} {_REASONS[option]}: leave out {', '.join(given)}, or start a new run "
            f"without {option}"
        )


def _is_given(context: typer.Context, name: str | None) -> bool:
    source = context.get_parameter_source(name) if name else None
    return source is not None and source.name != "DEFAULT"
