"""Metadata of an experiment: the file ``experiment.json`` in its folder."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from drivers.validation import describe_first_problem
from iher_robot.errors import UserError
from iher_robot.experiments.grid import Identity
from iher_robot.storage.files.atomic import read_file, write_atomically
from iher_robot.storage.files.checksum import add_checksum, load_checked


class _Process(BaseModel):
    model_config = ConfigDict(extra="allow")

    command: tuple[str, ...]


class _Metadata(BaseModel):
    title: str
    description: str
    manifest: str
    search: bool
    processes: tuple[_Process, ...]
    cells: tuple[Identity, ...]


def read_metadata(path: Path) -> dict[str, Any]:
    """Read the metadata; empty if there is no file yet.

    Returns:
        ``title``, ``description``, ``manifest``, ``search``, ``processes`` (provenance of each)
        and ``cells``.

    Raises:
        UserError: The file is damaged, or a key is missing.
    """
    if not path.exists():
        return {}
    metadata = load_checked(read_file(path, "experiment file"), path, "experiment file")
    try:
        _Metadata.model_validate_json(json.dumps(metadata), strict=True)
    except ValidationError as error:
        raise UserError(
            f"{path} is no experiment file of this version of iher-robot: "
            f"{describe_first_problem(error)}; restore it from a copy"
        ) from None
    names = [cell.name for cell in cells_of(metadata)]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise UserError(f"{path} names the cell {twice} twice; restore it from a copy")
    return metadata


def write_metadata(path: Path, metadata: Mapping[str, Any]) -> None:
    """Write the metadata.

    Raises:
        UserError: The file cannot be written, such as on a full disk.
    """
    text = json.dumps(add_checksum(metadata), indent=1, allow_nan=False) + "\n"
    write_atomically(path, lambda file: file.write(text.encode()))


def cells_of(metadata: Mapping[str, Any]) -> tuple[Identity, ...]:
    """The cells in the metadata."""
    return tuple(Identity(**identity) for identity in metadata["cells"])
