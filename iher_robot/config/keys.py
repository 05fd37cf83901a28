"""Dotted keys of a pydantic model, and error messages with the values that each key allows."""

from __future__ import annotations

import difflib
import reprlib
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from drivers.validation import list_problems
from iher_robot.config.layers import Layer
from iher_robot.errors import UserError

_TYPE_NAMES = {
    float: "a finite number",
    int: "an integer",
    bool: "true or false",
    str: "text",
    type(None): "off",
}
_LOWER = (("gt", "{} < "), ("ge", "{} <= "))
_UPPER = (("lt", " < {}"), ("le", " <= {}"))
_LOWER_IN_WORDS = (("gt", "above {}"), ("ge", "{} or more"))
_UPPER_IN_WORDS = (("lt", "below {}"), ("le", "up to {}"))


class Keys:
    """Dotted keys of nested sections.

    Args:
        model: The outermost section; a field whose type is a model is a section.
    """

    def __init__(self, model: type[BaseModel]) -> None:
        self.leaves: dict[str, FieldInfo] = {}
        self.sections: set[str] = set()
        self._collect(model, "")

    def _collect(self, model: type[BaseModel], prefix: str) -> None:
        for name, field in model.model_fields.items():
            key = prefix + name
            if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
                self.sections.add(key)
                self._collect(field.annotation, key + ".")
            else:
                self.leaves[key] = field

    def flatten(self, layer: Layer) -> dict[str, Any]:
        """Values of a layer by dotted key.

        Raises:
            UserError: A key does not exist, or a section has a single value.
        """
        return dict(self._walk(layer.values, "", layer.origin))

    def _walk(
        self, values: Mapping[Any, Any], prefix: str, origin: str
    ) -> Iterator[tuple[str, Any]]:
        for name, value in values.items():
            key = f"{prefix}{name}"
            if key in self.leaves:
                yield key, value
            elif key not in self.sections:
                raise self._unknown(key, origin)
            elif isinstance(value, Mapping):
                yield from self._walk(value, key + ".", origin)
            elif value is not None:
                raise UserError(
                    f"{origin}: {key} is {reprlib.repr(value)}, allowed: a section with the keys "
                    f"{', '.join(self._below(key))}"
                )

    @staticmethod
    def nest(values: Mapping[str, Any]) -> dict[str, Any]:
        """Nested mapping of dotted keys, the inverse of ``flatten``."""
        nested: dict[str, Any] = {}
        for key, value in values.items():
            *sections, name = key.split(".")
            place = nested
            for section in sections:
                place = place.setdefault(section, {})
            place[name] = value
        return nested

    def explain(self, error: ValidationError, origins: Mapping[str, Layer]) -> list[str]:
        """One sentence for each value that is not allowed.

        Args:
            error: Error of the model's validation.
            origins: Layer that set each dotted key.
        """
        sentences = []
        for problem in list_problems(error):
            key = self._known_prefix(problem.path)
            if key in self.leaves and problem.kind != "value_error":
                origin = origins.get(key, Layer("default", {}))
                sentences.append(self.out_of_range(key, problem.value, origin))
            else:
                sentences.append(f"{key}: {problem.reason}")
        return sentences

    def out_of_range(self, key: str, value: object, origin: Layer) -> str:
        """Message for a value that its key does not allow."""
        shown, field = reprlib.repr(value), self.leaves[key]
        if origin.option:
            return f"{origin.origin} is {shown}, allowed: {describe_in_words(field)}"
        allowed = describe_allowed(key.rpartition(".")[2], field)
        return f"{origin.origin}: {key} is {shown}, allowed: {allowed}"

    def _known_prefix(self, parts: Sequence[str]) -> str:
        """Drop list indices and branches of unions that pydantic appends."""
        for stop in range(len(parts), 0, -1):
            key = ".".join(parts[:stop])
            if key in self.leaves or key in self.sections:
                return key
        return ".".join(parts)

    def _unknown(self, key: str, origin: str) -> UserError:
        near = self._nearest(key)
        hint = f"; did you mean {near!r}?" if near else ""
        parent = key.rpartition(".")[0]
        place = f" in {parent}" if parent else ""
        return UserError(
            f"{origin}: unknown key {key!r}, valid{place}: {', '.join(self._below(parent))}{hint}"
        )

    def _below(self, section: str) -> list[str]:
        split = (key.rpartition(".") for key in [*self.leaves, *sorted(self.sections)])
        return [name for parent, _, name in split if parent == section]

    def _nearest(self, key: str) -> str | None:
        """Most similar valid key; a bare ``gama`` also finds ``learner.ddpg.gamma``."""

        def nearness(candidate: str) -> float:
            whole = difflib.SequenceMatcher(None, key, candidate).ratio()
            tails = (key.rpartition(".")[2], candidate.rpartition(".")[2])
            return max(whole, 0.9 * difflib.SequenceMatcher(None, *tails).ratio() + 0.1 * whole)

        best = max([*self.leaves, *self.sections], key=nearness)
        return best if nearness(best) >= 0.6 else None


def describe_allowed(name: str, field: FieldInfo) -> str:
    """Describe the allowed values of a field, such as ``a number with 0 < gamma <= 1``."""
    kind = _describe_type(field.annotation)
    bounds = _bound(field, _LOWER) + name + _bound(field, _UPPER)
    return kind if bounds == name else f"{kind} with {bounds}"


def describe_in_words(field: FieldInfo) -> str:
    """Describe them without the field's name, such as ``a number, above 0 and up to 1``."""
    bounds = [_bound(field, _LOWER_IN_WORDS), _bound(field, _UPPER_IN_WORDS)]
    said = " and ".join(filter(None, bounds))
    return ", ".join(filter(None, [_describe_type(field.annotation), said]))


def _bound(field: FieldInfo, forms: Sequence[tuple[str, str]]) -> str:
    for name, form in forms:
        for rule in field.metadata:
            if getattr(rule, name, None) is not None:
                return form.format(_number(getattr(rule, name)))
    return ""


def _number(bound: float) -> str:
    return f"{bound:.0f}" if bound >= 1e3 else str(bound)  # not 1000000.0


def _describe_type(annotation: Any) -> str:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Literal:
        return "one of " + ", ".join(map(str, arguments))
    if origin in (typing.Union, types.UnionType):
        # null first: the bounds that follow belong to the number.
        ordered = sorted(arguments, key=lambda argument: argument is not type(None))
        return " or ".join(map(_describe_type, ordered))
    if origin is typing.Annotated:
        return _describe_type(arguments[0])
    if origin is dict:
        return "keys with text, finite numbers, true, false or lists of them"
    if origin in (tuple, list):
        element = _describe_type(arguments[0]).removeprefix("an ").removeprefix("a ")
        return f"a list, each {element}"
    return _TYPE_NAMES.get(annotation, getattr(annotation, "__name__", str(annotation)))
