"""Where settings come from: the shipped YAML presets, a user's own file, and ``key=value``."""

from __future__ import annotations

import importlib.resources
import os
import re
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from iher_robot.durable_file import read_file
from iher_robot.errors import UserError, unknown_name

_SUFFIX = ".yaml"


@dataclass(frozen=True)
class Layer:
    """Settings of one origin, to be laid over those before it.

    Attributes:
        origin: Where they are from, for messages.
        values: Nested mapping, not yet checked.
        option: Whether the origin is an option that stands for its one key.
    """

    origin: str
    values: Mapping[Any, Any]
    option: bool = False


def preset_layer(preset: str, task: str) -> Layer:
    """Read ``presets/<preset>/<task>.yaml``, or a user's own file.

    Args:
        preset: Name of a shipped preset, or a path that ends in .yaml or .yml.
        task: Name of the task.

    Raises:
        UserError: No such preset, none for this task, or a file that is not valid YAML.
    """
    if is_preset_file(preset):
        return Layer(preset, parse_mapping(read_file(Path(preset), "preset file"), preset))
    folders = {entry.name: entry for entry in _entries("presets") if entry.is_dir()}
    if os.sep in preset:
        raise UserError(
            f"unknown preset {preset!r}: a path must be that of a YAML file, ending in .yaml or "
            f".yml; the presets with a name are: {', '.join(sorted(folders))}"
        )
    if preset not in folders:
        raise unknown_name("preset", preset, folders)
    files = {entry.name: entry for entry in folders[preset].iterdir()}
    name = task + _SUFFIX
    if name not in files:
        tasks = (file.removesuffix(_SUFFIX) for file in files if file.endswith(_SUFFIX))
        raise unknown_name(f"task of preset {preset!r}", task, tasks)
    origin = f"configs/presets/{preset}/{name}"
    return Layer(origin, parse_mapping(files[name].read_bytes(), origin))


def is_preset_file(preset: str) -> bool:
    """Whether a preset is the path of a user's own file."""
    return Path(preset).suffix in (".yaml", ".yml")


def algorithm_layer(algo: str) -> Layer:
    """Read ``algorithms/<algo>.yaml``.

    Raises:
        UserError: No such algorithm, or a file that is not valid YAML.
    """
    files = {
        entry.name.removesuffix(_SUFFIX): entry
        for entry in _entries("algorithms")
        if entry.name.endswith(_SUFFIX)
    }
    if algo not in files:
        raise unknown_name("algorithm", algo, files)
    origin = f"configs/algorithms/{algo}{_SUFFIX}"
    return Layer(origin, parse_mapping(files[algo].read_bytes(), origin))


def override_layer(override: str) -> Layer:
    """Parse one ``key=value`` of ``--set``, such as ``learner.ddpg.gamma=0.95``.

    Raises:
        UserError: There is no key or no ``=``, or the value is not valid YAML.
    """
    key, equals, text = override.partition("=")
    parts = key.strip().split(".")
    origin = f"--set {textwrap.shorten(override, 80)}"
    if not equals or not all(parts):
        raise UserError(f"{origin}: expected key=value, such as learner.ddpg.gamma=0.95")
    value = _parse(text.encode(), origin)
    for part in reversed(parts):
        value = {part: value}
    return Layer(origin, value)


def option_layer(key: str, value: object) -> Layer:
    """Setting that has an option of its own, such as ``--budget-minutes``.

    Args:
        key: The setting.
        value: Its value, not text to be parsed; None is off.
    """
    plain = value.item() if isinstance(value, np.generic) else value
    return Layer("--" + key.replace("_", "-"), {key: plain}, option=True)


def parse_mapping(text: bytes, origin: str) -> Mapping[Any, Any]:
    """Parse YAML whose top level is a mapping; an empty file is an empty mapping.

    Raises:
        UserError: It is not, or not valid YAML.
    """
    value = _parse(text, origin)
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise UserError(f"{origin}: expected lines of 'key: value', not {type(value).__name__}")
    return value


def format_yaml(values: Mapping[str, Any]) -> str:
    """Write settings so that parsing them gives the same values back."""
    # In ASCII: PyYAML does not quote every Unicode line break.
    return yaml.dump(dict(values), Dumper=_Dumper, sort_keys=False, allow_unicode=False)


def _entries(folder: str) -> list[Traversable]:
    return list(_configs_root().joinpath(folder).iterdir())


def _configs_root() -> Traversable:
    return importlib.resources.files("iher_robot").joinpath("configs")


def _parse(text: bytes, origin: str) -> Any:
    try:
        return yaml.load(text.decode(), Loader=_Loader)  # noqa: S506 (a SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f" in line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        raise UserError(f"{origin} is not valid YAML: {error.problem}{place}") from error
    except (yaml.YAMLError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise UserError(f"{origin} is not valid YAML: {reason}") from error
    except RecursionError:
        raise UserError(f"{origin} is not valid YAML: nested too deeply") from None


class _Loader(yaml.SafeLoader):
    """Plain YAML 1.2 scalars, no key twice, no aliases.

    YAML 1.1 would read ``off`` as false, ``1e-3`` as text, ``1:30`` as 90 and ``010`` as 8.
    Aliases could make a short file endless.
    """

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Refuse aliases."""
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise yaml.composer.ComposerError(None, None, "aliases are not allowed", mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Refuse what SafeLoader silently overwrites."""
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.value in seen:
                problem = f"key {key.value!r} twice, or no text"
                raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


class _Dumper(yaml.SafeDumper):
    """Quotes exactly what ``_Loader`` would not read as text."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002 (PyYAML's signature)
        """Write equal values out each time."""
        return True


_SCALARS = {
    "null": (r"~|null|", ["~", "n", ""]),
    "bool": (r"true|false", ["t", "f"]),
    "int": (r"[-+]?(?:0|[1-9][0-9_]*)", list("-+0123456789")),
    "float": (
        r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.inf|\.nan",
        list("-+.0123456789"),
    ),
}
for _class in (_Loader, _Dumper):
    _class.yaml_implicit_resolvers = {}
    for _tag, (_pattern, _first) in _SCALARS.items():
        _class.add_implicit_resolver(
            f"tag:yaml.org,2002:{_tag}", re.compile(rf"^(?:{_pattern})$"), _first
        )
