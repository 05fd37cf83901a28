"""Settings of a run: typed defaults, overlaid by a preset, an algorithm and ``--set``."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from iher_robot.config.keys import Keys
from iher_robot.config.layers import (
    Layer,
    algorithm_layer,
    is_yaml_file,
    option_layer,
    preset_layer,
)
from iher_robot.config.robot import ChosenRobot
from iher_robot.config.yaml import format_yaml, parse_mapping
from iher_robot.errors import UserError
from iher_robot.learning.config import OR_OFF, LearnerConfig
from iher_robot.storage.files.atomic import read_file

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
    return resolve([given, option_layer("simulators", simulators)])


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
    config = resolve([layer])
    try:
        algorithm_layer(config.algo)
        if not is_yaml_file(config.preset):  # a user's file may be gone; all its values are here
            preset_layer(config.preset, config.task)
    except UserError as error:
        raise UserError(f"{path}: {error}") from error
    return config


def resolve(layers: Sequence[Layer]) -> RunConfig:
    """Merge layers; later ones win.

    Raises:
        UserError: An unknown key, or a value out of range, with its origin.
    """
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
