"""Sentences for values that a pydantic model refuses."""

from __future__ import annotations

import typing
from collections.abc import Sequence
from dataclasses import dataclass

from pydantic import BaseModel, ValidationError

from drivers.names import unknown


@dataclass(frozen=True)
class Problem:
    """A value that is not allowed.

    Attributes:
        path: Fields and indices that lead to it; empty for the whole model.
        kind: Pydantic's name of the error, such as ``"missing"``.
        reason: What is wrong with it, without a full stop.
        value: The value; for a missing one the mapping that lacks it.
    """

    path: tuple[str, ...]
    kind: str
    reason: str
    value: object

    @property
    def key(self) -> str:
        """The path with dots."""
        return ".".join(self.path)


def list_problems(error: ValidationError) -> list[Problem]:
    """Every value that is not allowed, in the model's order."""
    return [
        Problem(
            path=tuple(map(str, detail["loc"])),
            kind=detail["type"],
            reason=" ".join(detail["msg"].removeprefix("Value error, ").split()),
            value=detail["input"],
        )
        for detail in error.errors(include_url=False, include_context=False)
    ]


def describe_first_problem(error: ValidationError) -> str:
    """Describe the first value that is not allowed, such as ``cells.0.name: Field required``."""
    first = list_problems(error)[0]
    return f"{first.key}: {first.reason}" if first.path else first.reason


def describe_problems(error: ValidationError, model: type[BaseModel], kind: str) -> str:
    """Describe every setting that is not allowed, joined by semicolons.

    Args:
        error: What the model's validation raised.
        model: The model. A field whose type is a model, or a model or None, is a section.
        kind: What a key of the model is, such as ``"robot setting"``.
    """
    return "; ".join(_sentence(problem, model, kind) for problem in list_problems(error))


def _sentence(problem: Problem, model: type[BaseModel], kind: str) -> str:
    path, key, shown = problem.path, problem.key, repr(problem.value)
    if not path:
        return problem.reason
    if problem.kind == "extra_forbidden":
        section = _section(model, path[:-1]) or model
        return unknown(kind, key, (".".join((*path[:-1], name)) for name in section.model_fields))
    if problem.kind == "missing":
        return f"{kind} {key} is missing"
    wanted = _section(model, path)
    if problem.kind == "model_type" and wanted is not None:
        keys = ", ".join(wanted.model_fields)
        return f"{kind} {key} is {shown}, allowed: a section with the keys {keys}"
    return f"{kind} {key} is {shown}: {problem.reason[:1].lower()}{problem.reason[1:]}"


def _section(model: type[BaseModel], path: Sequence[str]) -> type[BaseModel] | None:
    """The model of a section; None where the path leads to none."""
    found: type[BaseModel] | None = model
    for name in path:
        field = None if found is None else found.model_fields.get(name)
        types = () if field is None else (field.annotation, *typing.get_args(field.annotation))
        models = (each for each in types if isinstance(each, type) and issubclass(each, BaseModel))
        found = next(models, None)
    return found
