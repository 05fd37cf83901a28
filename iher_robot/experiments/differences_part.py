"""What tells the settings of two runs apart."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from iher_robot.config.run import RunConfig, plain_identity

_ABSENT = object()


def differences(first: RunConfig, second: RunConfig) -> dict[str, tuple[Any, Any]]:
    """Settings in which two runs differ and on which their results depend.

    Returns:
        Both values by dotted key, None for one that is not there.
    """
    one, two = _flat(plain_identity(first)), _flat(plain_identity(second))
    return {
        key: (one.get(key), two.get(key))
        for key in {**one, **two}
        if one.get(key, _ABSENT) != two.get(key, _ABSENT)
    }


def _flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping) and value:
            found |= _flat(value, f"{prefix}{key}.")
        else:
            found[prefix + key] = value
    return found
