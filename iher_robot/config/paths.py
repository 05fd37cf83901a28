"""Paths in settings files, which are relative to the folder of the file."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

TLS_PATHS = ("tls.ca", "tls.certificate", "tls.key")
"""Paths in a section ``tls``."""


def resolve_paths(
    settings: Mapping[Any, Any], file: str | Path, keys: Collection[str]
) -> dict[str, Any]:
    """Make the paths in a settings file absolute.

    Args:
        settings: Content of the file, not yet checked. A path that is no text stays as it is.
        file: The file.
        keys: Settings that are paths; a dot separates section and key.
    """
    return _resolve(settings, "", Path(file).absolute().parent, keys)


def _resolve(
    settings: Mapping[Any, Any], prefix: str, folder: Path, keys: Collection[str]
) -> dict[str, Any]:
    resolved: dict[str, Any] = {}
    for name, value in settings.items():
        key = f"{prefix}{name}"
        if isinstance(value, Mapping):
            resolved[str(name)] = _resolve(value, f"{key}.", folder, keys)
        elif isinstance(value, str) and key in keys:
            resolved[str(name)] = str(folder / value)
        else:
            resolved[str(name)] = value
    return resolved
