"""YAML of settings: scalars of YAML 1.2, no aliases, no code."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import yaml

from iher_robot.errors import UserError


def parse_mapping(text: bytes, origin: str) -> Mapping[Any, Any]:
    """Parse YAML whose top level is a mapping; an empty file is an empty mapping.

    Raises:
        UserError: The text is no mapping, or not valid YAML.
    """
    value = parse_value(text, origin)
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise UserError(f"{origin}: expected lines of 'key: value', not {type(value).__name__}")
    return value


def format_yaml(values: Mapping[str, Any]) -> str:
    """Write settings as YAML that parses to the same values."""
    # In ASCII: PyYAML does not quote every Unicode line break.
    return yaml.dump(dict(values), Dumper=_Dumper, sort_keys=False, allow_unicode=False)


def parse_value(text: bytes, origin: str) -> Any:
    """Parse YAML.

    Raises:
        UserError: The text is not valid, or has aliases or a duplicate key.
    """
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
    """Loader of YAML 1.2 scalars that refuses duplicate keys and aliases.

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
        """Refuse duplicate keys, which SafeLoader silently overwrites."""
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.value in seen:
                problem = f"key {key.value!r} is duplicate or no text"
                raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


class _Dumper(yaml.SafeDumper):
    """Dumper that quotes exactly what ``_Loader`` would not read as text."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002 (PyYAML's signature)
        """Write every value in full."""
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
