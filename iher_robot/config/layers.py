"""Layers of settings: shipped YAML files, a user's files, options and ``key=value``."""

from __future__ import annotations

import importlib.resources
import os
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np

from iher_robot.config.yaml import parse_mapping, parse_value
from iher_robot.errors import UserError, unknown_name
from iher_robot.storage.files.atomic import read_file

_SUFFIX = ".yaml"
_USERS_KINDS = ("preset", "robot", "experiment")  # a user may have files of these kinds


@dataclass(frozen=True)
class Layer:
    """Settings from one origin, which override earlier layers.

    Attributes:
        origin: Origin for messages.
        values: Nested mapping, not yet checked.
        option: Whether the origin is a command-line option for its only key.
    """

    origin: str
    values: Mapping[Any, Any]
    option: bool = False


def preset_layer(preset: str, task: str) -> Layer:
    """Read ``presets/<preset>/<task>.yaml``, or a user's file.

    Args:
        preset: Name of a shipped preset, or a path that ends in .yaml or .yml.
        task: Name of the task.

    Raises:
        UserError: The preset does not exist, has no file for the task, or is not valid YAML.
    """
    if is_yaml_file(preset):
        return _own_file("preset", preset)
    folders = {entry.name: entry for entry in _entries("presets") if entry.is_dir()}
    if preset not in folders:
        raise _unknown("preset", preset, folders)
    files = {entry.name: entry for entry in folders[preset].iterdir()}
    name = task + _SUFFIX
    if name not in files:
        tasks = (file.removesuffix(_SUFFIX) for file in files if file.endswith(_SUFFIX))
        raise unknown_name(f"task of preset {preset!r}", task, tasks)
    origin = f"configs/presets/{preset}/{name}"
    return Layer(origin, parse_mapping(files[name].read_bytes(), origin))


def is_yaml_file(name: str) -> bool:
    """Whether a name is the path of a user's file."""
    return Path(name).suffix in (".yaml", ".yml")


def algorithm_layer(algo: str) -> Layer:
    """Read ``algorithms/<algo>.yaml``.

    Raises:
        UserError: The algorithm does not exist, or its file is not valid YAML.
    """
    return _shipped_file("algorithm", algo)


def robot_layer(robot: str) -> Layer:
    """Read ``robots/<robot>.yaml``, or a user's file.

    Args:
        robot: Name of a shipped robot, or a path that ends in .yaml or .yml.

    Raises:
        UserError: The robot does not exist, or its file is not valid YAML.
    """
    return _own_file("robot", robot) if is_yaml_file(robot) else _shipped_file("robot", robot)


def experiment_layer(experiment: str) -> Layer:
    """Read ``experiments/<experiment>.yaml``, or a user's file.

    Args:
        experiment: Name of a shipped experiment, or a path that ends in .yaml or .yml.

    Raises:
        UserError: The experiment does not exist, or its file is not valid YAML.
    """
    if is_yaml_file(experiment):
        return _own_file("experiment", experiment)
    return _shipped_file("experiment", experiment)


def experiment_names() -> tuple[str, ...]:
    """Names of the shipped experiments."""
    names = (entry.name for entry in _entries("experiments"))
    return tuple(sorted(name.removesuffix(_SUFFIX) for name in names if name.endswith(_SUFFIX)))


def override_layer(override: str) -> Layer:
    """Parse one ``key=value`` of ``--set``, such as ``learner.ddpg.gamma=0.95``.

    Raises:
        UserError: The key or ``=`` is missing, or the value is not valid YAML.
    """
    key, equals, text = override.partition("=")
    parts = key.strip().split(".")
    origin = f"--set {textwrap.shorten(override, 80)}"
    if not equals or not all(parts):
        raise UserError(f"{origin}: expected key=value, such as learner.ddpg.gamma=0.95")
    value = parse_value(text.encode(), origin)
    for part in reversed(parts):
        value = {part: value}
    return Layer(origin, value)


def option_layer(key: str, value: object) -> Layer:
    """Setting of a command-line option, such as ``--budget-minutes``.

    Args:
        key: The setting.
        value: Its value, already parsed; None is off.
    """
    plain = value.item() if isinstance(value, np.generic) else value
    return Layer("--" + key.replace("_", "-"), {key: plain}, option=True)


def _own_file(kind: str, path: str) -> Layer:
    return Layer(path, parse_mapping(read_file(Path(path), f"{kind} file"), path))


def _shipped_file(kind: str, name: str) -> Layer:
    """Read a shipped file, from the folder of its kind."""
    folder = f"{kind}s"
    files = {
        entry.name.removesuffix(_SUFFIX): entry
        for entry in _entries(folder)
        if entry.name.endswith(_SUFFIX)
    }
    if name not in files:
        raise _unknown(kind, name, files)
    origin = f"configs/{folder}/{name}{_SUFFIX}"
    return Layer(origin, parse_mapping(files[name].read_bytes(), origin))


def _unknown(kind: str, name: str, shipped: Iterable[str]) -> UserError:
    if os.sep in name and kind in _USERS_KINDS:
        return UserError(
            f"unknown {kind} {name!r}: the path of a YAML file must end in .yaml or .yml; "
            f"shipped {kind}s: {', '.join(sorted(shipped))}"
        )
    return unknown_name(kind, name, shipped)


def _entries(folder: str) -> list[Traversable]:
    return list(_configs_root().joinpath(folder).iterdir())


def _configs_root() -> Traversable:
    return importlib.resources.files("iher_robot.config").joinpath("configs")
