"""Torch files with a checksum and a format version, loaded without executing code."""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from typing import Any

import torch

from iher_robot.errors import UserError
from iher_robot.storage.files.atomic import read_file, write_atomically
from iher_robot.storage.files.checksum import add_zip_checksum, check_zip


def save_torch_file(path: Path, content: dict[str, Any], *, kind: str, version: int) -> None:
    """Write a dict of plain values atomically.

    The file is what ``torch.save`` writes, for ``torch.load(path, weights_only=True)``, with a
    checksum in the comment of the archive.

    Args:
        path: The file.
        content: Dicts, lists, text, numbers, tensors.
        kind: Kind of the file, such as ``"policy"``.
        version: Format version, from 1.

    Raises:
        UserError: The system refuses, such as on a full disk; the old file is still there.
    """
    buffer = io.BytesIO()
    torch.save({"format": f"iher-robot {kind}", "version": version} | content, buffer)
    archive = add_zip_checksum(buffer.getvalue())
    write_atomically(path, lambda file: file.write(archive))


def load_torch_file(path: Path, *, kind: str, version: int, oldest: int = 1) -> dict[str, Any]:
    """Read what ``save_torch_file`` wrote, onto the CPU.

    Args:
        path: The file.
        kind: Kind of the file.
        version: Newest version that can be read.
        oldest: Oldest version that can be read.

    Returns:
        The content, with ``format`` and ``version``.

    Raises:
        UserError: The file is missing, damaged, of another kind, or of another version.
    """
    archive = read_file(path, f"{kind} file")
    check_zip(archive, path, f"{kind} file")
    try:
        content = torch.load(io.BytesIO(archive), map_location="cpu", weights_only=True)
    except (
        pickle.UnpicklingError,
        RuntimeError,
        ArithmeticError,
        AttributeError,
        EOFError,
        LookupError,
        OSError,
        TypeError,
        ValueError,
    ) as error:
        raise UserError(f"{path} is no {kind} file of iher-robot: torch cannot read it") from error
    if not isinstance(content, dict) or content.get("format") != f"iher-robot {kind}":
        raise UserError(f"{path} is a torch file, but no {kind} file of iher-robot")
    found = content.get("version")
    if type(found) is not int or found < 1:
        raise UserError(f"{path} is damaged: its format version is {found!r}")
    if found > version:
        raise UserError(
            f"{path} has {kind} format {found}, this iher-robot reads up to {version}; update it"
        )
    if found < oldest:
        raise UserError(
            f"{path} has {kind} format {found}, this iher-robot reads {oldest} to {version}; use "
            "the iher-robot that wrote it"
        )
    return content
