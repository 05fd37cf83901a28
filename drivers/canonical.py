"""Canonical JSON of specification values: conversion, digest, differences."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Mapping
from typing import TypeAlias

Json: TypeAlias = "bool | int | float | str | list[Json] | dict[str, Json] | None"


def to_json(value: object) -> Json:
    """Turn a specification value into plain JSON data.

    Args:
        value: Dataclasses, mappings, sequences and scalars, nested.

    Returns:
        The same as dicts, lists and scalars. Infinities, which JSON lacks, become ``"inf"`` and
        ``"-inf"``.

    Raises:
        TypeError: If it contains a value of another type.
        ValueError: If it contains NaN.
    """
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        if math.isnan(value):
            raise ValueError("a specification contains nan, allowed: finite numbers and infinity")
        return value if math.isfinite(value) else ("inf" if value > 0 else "-inf")
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = dataclasses.fields(value)
        return {field.name: to_json(getattr(value, field.name)) for field in fields}
    if isinstance(value, Mapping):
        return {str(key): to_json(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [to_json(item) for item in value]
    raise TypeError(f"{type(value).__name__} has no JSON form; use scalars, tuples and dataclasses")


def digest(value: object) -> str:
    """Hash a specification value.

    Args:
        value: As for `to_json`.

    Returns:
        The SHA-256 of its canonical JSON text, 64 hexadecimal digits.
    """
    text = json.dumps(to_json(value), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def differences(mine: Json, other: Json, path: str = "") -> list[str]:
    """List every leaf in which two JSON values differ.

    Args:
        mine: One value.
        other: The value it is compared with.
        path: Name of the value, a prefix of the leaves' names.

    Returns:
        Sentences such as ``"limits.watchdog_s: 0.1, not 0.2"``, in the order of the names.
    """
    if isinstance(mine, dict) and isinstance(other, dict):
        found: list[str] = []
        for key in sorted(mine.keys() | other.keys()):
            name = f"{path}.{key}" if path else key
            if key not in mine:
                found.append(f"{name}: absent, not {json.dumps(other[key])}")
            elif key not in other:
                found.append(f"{name}: {json.dumps(mine[key])}, not absent")
            else:
                found.extend(differences(mine[key], other[key], name))
        return found
    return [] if mine == other else [f"{path}: {json.dumps(mine)}, not {json.dumps(other)}"]
