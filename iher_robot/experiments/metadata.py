"""What an experiment is: the file ``experiment.json`` in its folder."""

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


class _Origin(BaseModel):
    title: str
    description: str
    manifest: str
    search: bool
    processes: tuple[_Process, ...]
    cells: tuple[Identity, ...]


def read_origin(path: Path) -> dict[str, Any]:
    """What the experiment is; empty if nothing is known of it yet.

    Returns:
        ``title``, ``description``, ``manifest``, ``search``, and of each process and each cell
        what is known.

    Raises:
        UserError: The file is damaged, or something is missing in it.
    """
    if not path.exists():
        return {}
    origin = load_checked(read_file(path, "experiment file"), path, "experiment file")
    try:
        _Origin.model_validate_json(json.dumps(origin), strict=True)
    except ValidationError as error:
        raise UserError(
            f"{path} is no experiment file of this version of iher-robot: "
            f"{describe_first_problem(error)}; restore it from a copy"
        ) from None
    names = [cell.name for cell in cells_of(origin)]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise UserError(f"{path} names the cell {twice} twice; restore it from a copy")
    return origin


def write_origin(path: Path, origin: Mapping[str, Any]) -> None:
    """Write what the experiment is.

    Raises:
        UserError: The system refuses, such as on a full disk.
    """
    text = json.dumps(add_checksum(origin), indent=1, allow_nan=False) + "\n"
    write_atomically(path, lambda file: file.write(text.encode()))


def cells_of(origin: Mapping[str, Any]) -> tuple[Identity, ...]:
    """The cells that an experiment has begun with."""
    return tuple(Identity(**identity) for identity in origin["cells"])
