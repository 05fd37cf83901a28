"""Options of a new run, and the settings that they resolve to."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypedDict, Unpack

from iher_robot.config.layers import (
    Layer,
    algorithm_layer,
    option_layer,
    override_layer,
    preset_layer,
)
from iher_robot.config.robot import choose_robot
from iher_robot.config.run import RunConfig, resolve
from iher_robot.errors import UserError
from tasks import canonical_name

# Keys that presets and overrides cannot set, and the option that does.
_CHOSEN = {
    "task": "--task",
    "preset": "--preset",
    "algo": "--algo",
    "robot": "--robot",
    "robot_options": "--robot",
    "from_data": "--from-data",
}


class RunOptions(TypedDict, total=False):
    """Options of a new run, as ``iher-robot train`` takes them; an absent one is the preset's."""

    preset: str
    """Name of a preset, or the path of a YAML file; ``default`` where absent."""
    algo: str
    """Name of an algorithm; ``iher`` where absent."""
    overrides: Sequence[str]
    """``key=value`` each, such as ``learner.ddpg.gamma=0.95``."""
    driver: str | None
    """Name of the robot driver; by default what the robot's file names, or ``mujoco``."""
    robot: str | None
    """Name of a shipped robot or of one on the network, or the path of a YAML file; the driver's
    default where None."""
    connect: Sequence[str]
    """Where to reach a robot on the network; what its file says where empty."""
    from_data: Sequence[str | Path]
    """Folders of earlier runs of the same task and robot, whose real episodes cost nothing."""
    budget_minutes: float | None
    """Robot minutes to spend."""
    seed: int
    """Decides every random draw."""
    device: str
    """Where replay, models and policy live: ``auto``, ``cpu`` or ``cuda``."""
    until_success: float | None
    """Stop when the last two evaluations reach this rate; None never stops."""
    asynchronous: bool | None
    """Learn in a process of its own while the robot moves."""
    simulators: int | None
    """Simulated robots in parallel."""


# Settings that have an option of their own; None is a value of one of them.
_OPTIONS = (
    "seed",
    "device",
    "until_success",
    "driver",
    "asynchronous",
    "simulators",
    "budget_minutes",
)


def load_config(task: str, **options: Unpack[RunOptions]) -> RunConfig:
    """Resolve the settings of a new run; later layers win.

    Args:
        task: Name of the task.
        options: Options of the run; errors name the option of the command line.

    Returns:
        Typed defaults, then the preset's file for the task, the algorithm's, the options and the
        overrides.

    Raises:
        UserError: An unknown name or key, or a value out of range; or a file is not valid YAML.
    """
    check_options("load_config", options)
    task = canonical_name(task)
    preset, algo = options.get("preset", "default"), options.get("algo", "iher")
    layers = [
        preset_layer(preset, task),
        algorithm_layer(algo),
        *_option_layers(options),
        *map(override_layer, options.get("overrides", ())),
    ]
    for layer in layers:
        for key, option in _CHOSEN.items():
            if key in layer.values:
                raise UserError(f"{layer.origin}: {key} cannot be set there, use {option}")
    from_data = _folders(options.get("from_data", ()))
    given = {"task": task, "preset": preset, "algo": algo, "from_data": from_data}
    chosen = Layer("command line", given)
    # Any layer may name the driver, and the driver says which robot is the default. Where none
    # does, the robot's file may.
    resolved = resolve([*layers, chosen])
    named = any("driver" in layer.values for layer in layers)
    chosen_robot = choose_robot(
        resolved.driver if named else None, options.get("robot"), options.get("connect", ())
    )
    settings = {
        "driver": chosen_robot.driver,
        "robot": chosen_robot.name,
        "robot_options": chosen_robot.options,
    }
    return resolve([*layers, chosen, Layer(f"robot {chosen_robot.name}", settings)])


def check_options(function: str, options: RunOptions) -> None:
    """Refuse options that a run does not have, as Python refuses unknown keyword arguments.

    Raises:
        TypeError: There is one.
    """
    for name in options:
        if name not in RunOptions.__annotations__:
            raise TypeError(f"{function}() got an unexpected keyword argument {name!r}")


def _option_layers(options: RunOptions) -> Iterator[Layer]:
    values: Mapping[str, object] = options
    for key in _OPTIONS:
        if key in values and (values[key] is not None or key == "until_success"):
            yield option_layer(key, values[key])


def _folders(sources: Sequence[str | Path]) -> list[str]:
    folders = [str(Path(source).resolve()) for source in sources]
    for folder in folders:
        if folders.count(folder) > 1:
            raise UserError(f"--from-data names {folder} twice; name each folder once")
    return folders
