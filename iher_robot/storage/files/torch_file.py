"""Torch files that are whole or refused, and of which nothing is ever executed."""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from typing import Any

import torch

from iher_robot.errors import UserError
from iher_robot.storage.files.atomic import check_seal, read_file, seal_zip, write_atomically


def save_torch_file(path: Path, content: dict[str, Any], *, kind: str, version: int) -> None:
    """Write a dict of plain values; after a crash the old file or the new one is there, whole.

    The file is what ``torch.save`` writes, for ``torch.load(path, weights_only=True)``, with a
    digest of its bytes in the archive's comment.

    Args:
        path: The file.
        content: Dicts, lists, text, numbers, tensors.
        kind: What it is, such as ``"policy"``.
        version: Version of its format, from 1.

    Raises:
        UserError: The system refuses, such as on a full disk; the old file is still there.
    """
    buffer = io.BytesIO()
    torch.save({"format": f"iher-robot {kind}", "version": version} | content, buffer)
    sealed = seal_zip(buffer.getvalue())
    write_atomically(path, lambda file: file.write(sealed))


def load_torch_file(path: Path, *, kind: str, version: int, oldest: int = 1) -> dict[str, Any]:
    """Read what ``save_torch_file`` wrote, onto the CPU.

    Args:
        path: The file.
        kind: What it should be.
        version: The newest version that can be read.
        oldest: The oldest one.

    Returns:
        The content, with ``format`` and ``version``.

    Raises:
        UserError: The file is missing, truncated, damaged, foreign, or of another version.
    """
    sealed = read_file(path, f"{kind} file")
    check_seal(sealed, path, f"{kind} file")
    try:
        content = torch.load(io.BytesIO(sealed), map_location="cpu", weights_only=True)
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
        raise UserError(f"{path} is no {kind} file of iher-robot, but some other torch file")
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
