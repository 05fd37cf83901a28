"""Settings of a run: typed defaults, overlaid by a preset, an algorithm and ``--set``."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict, Unpack

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from iher_robot.config.keys import Keys
from iher_robot.config.layers import (
    Layer,
    algorithm_layer,
    is_yaml_file,
    option_layer,
    override_layer,
    preset_layer,
)
from iher_robot.config.robot import ChosenRobot, choose_robot
from iher_robot.config.yaml import format_yaml, parse_mapping
from iher_robot.errors import UserError
from iher_robot.learning.config import OR_OFF, LearnerConfig
from iher_robot.storage.files.atomic import read_file
from tasks import canonical_name

_CHOSEN = {
    "task": "--task",
    "preset": "--preset",
    "algo": "--algo",
    "robot": "--robot",
    "robot_options": "--robot",
    "from_data": "--from-data",
}


_CHANGES_NOTHING = ("simulators",)
"""Settings that do not affect the numbers of a run; a resumed run may change them."""


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


class EvaluationConfig(_Section):
    """Evaluation of the policy during training."""

    every_epochs: int = Field(default=1, ge=1)
    """Epochs from one evaluation to the next."""
    episodes: int = Field(default=40, ge=1)
    """Episodes of one evaluation in simulation."""
    robot_episodes: int = Field(default=10, ge=1)
    """Episodes of one evaluation on a robot without a simulator."""
    final_episodes: int = Field(default=100, ge=0)
    """Fresh episodes that evaluate the final policy, in simulation; 0 for none."""


class RunConfig(_Section):
    """Settings of a training run."""

    task: str = "push"
    """Name of the task."""
    driver: str = "mujoco"
    """Name of the robot driver."""
    robot: str = ""
    """Name of the robot, or the path of its file."""
    robot_options: dict[str, Any] = {}
    """Options of the robot, as read when the run began."""
    preset: str = "default"
    """Name of the preset, or the path of its file."""
    algo: str = "iher"
    """Name of the algorithm."""
    seed: int = Field(default=0, ge=0, lt=2**63)
    """Seed of every random draw."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where replay, models and policy live; auto takes a GPU if there is one."""
    threads: int = Field(default=1, ge=1, le=1024)
    """Threads of torch's matrix products on the CPU. With more than there are idle cores, waiting
    for a busy one costs most of the speed."""
    asynchronous: bool = False
    """Learn in a separate process while the robot collects the next epoch, instead of in turn."""
    simulators: int = Field(default=1, ge=1, le=64)
    """Simulated robots that collect and evaluate in parallel, one process each; results do not
    depend on the number. 1 for any other robot."""
    budget_minutes: float = Field(default=40.0, gt=0, le=1e6, allow_inf_nan=False)
    """Robot minutes: control ticks times the control period; at most about two years."""
    from_data: tuple[str, ...] = ()
    """Folders of earlier runs whose real episodes the learner begins with."""
    until_success: Annotated[float | None, OR_OFF] = Field(default=1.0, gt=0, le=1)
    """Stop early at this success rate; ``off`` spends the whole budget."""
    patience_minutes: float = Field(default=10.0, ge=0, allow_inf_nan=False)
    """Wall-clock minutes to wait for a robot that is lost, in use by another client, or stopped;
    then the run ends and can be resumed."""
    evaluation: EvaluationConfig = EvaluationConfig()
    learner: LearnerConfig = LearnerConfig()

    @property
    def chosen_robot(self) -> ChosenRobot:
        """The robot of the run."""
        return ChosenRobot(self.driver, self.robot, self.robot_options)


_KEYS = Keys(RunConfig)


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
    resolved = _resolve([*layers, chosen])
    named = any("driver" in layer.values for layer in layers)
    chosen_robot = choose_robot(
        resolved.driver if named else None, options.get("robot"), options.get("connect", ())
    )
    settings = {
        "driver": chosen_robot.driver,
        "robot": chosen_robot.name,
        "robot_options": chosen_robot.options,
    }
    return _resolve([*layers, chosen, Layer(f"robot {chosen_robot.name}", settings)])


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


def dump_config(config: RunConfig) -> str:
    """Write every setting as YAML, for ``read_config``."""
    return format_yaml(config.model_dump(mode="json"))


def plain_identity(config: RunConfig) -> dict[str, Any]:
    """Every setting that affects the numbers of a run, as plain values."""
    return config.model_dump(mode="json", exclude=set(_CHANGES_NOTHING))


def dump_identity(config: RunConfig) -> str:
    """Write these settings as YAML, which a resumed run must match."""
    return format_yaml(plain_identity(config))


def change_simulators(config: RunConfig, simulators: int) -> RunConfig:
    """Replace the number of simulators.

    Args:
        config: Settings of a run.
        simulators: The new number.

    Raises:
        UserError: It is out of range.
    """
    given = Layer("settings of the run", config.model_dump(mode="json"))
    return _resolve([given, option_layer("simulators", simulators)])


def read_config(path: Path) -> RunConfig:
    """Read settings from ``dump_config``, exactly as they were written.

    Raises:
        UserError: The file is missing, not valid YAML, or incomplete, or holds unknown keys, bad
            values, or a preset or an algorithm that does not exist.
    """
    layer = Layer(str(path), parse_mapping(read_file(path, "config file"), str(path)))
    given = _KEYS.flatten(layer)
    missing = [key for key in _KEYS.leaves if key not in (*given, *_CHANGES_NOTHING)]
    if missing:
        # Defaults must not fill in: the run would continue with other settings.
        raise UserError(
            f"{path} has no {missing[0]}: it is damaged, or from another version of iher-robot; "
            "restore it as it was, or start a new run"
        )
    config = _resolve([layer])
    try:
        algorithm_layer(config.algo)
        if not is_yaml_file(config.preset):  # a user's file may be gone; all its values are here
            preset_layer(config.preset, config.task)
    except UserError as error:
        raise UserError(f"{path}: {error}") from error
    return config


def _resolve(layers: Sequence[Layer]) -> RunConfig:
    values: dict[str, Any] = {}
    origins: dict[str, Layer] = {}
    for layer in layers:
        for key, value in _KEYS.flatten(layer).items():
            values[key], origins[key] = value, layer
            if _has_non_finite(value):
                raise UserError(_KEYS.out_of_range(key, value, layer))
    try:
        # Through JSON, for its strict mode: a list is a tuple, but true is no number and "3" is
        # no integer.
        text = json.dumps(_KEYS.nest(values), default=str)
        return RunConfig.model_validate_json(text, strict=True)
    except ValidationError as error:
        raise UserError("; ".join(_KEYS.explain(error, origins))) from None


def _has_non_finite(value: object) -> bool:
    if isinstance(value, float):
        return not math.isfinite(value)
    if isinstance(value, Mapping):
        return any(map(_has_non_finite, value.values()))
    return isinstance(value, list) and any(map(_has_non_finite, value))
