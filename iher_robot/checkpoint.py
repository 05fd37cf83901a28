"""Checkpoints at epoch boundaries: written whole or not at all, read without unpickling code."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import torch

from iher_robot.durable_file import check_seal, read_file, seal_zip, write_atomically
from iher_robot.errors import UserError

FORMAT = "iher-robot checkpoint"
VERSION = 1
_KIND = "checkpoint"


def save_checkpoint(path: Path, learner: dict[str, Any], run: dict[str, float | int]) -> None:
    """Replace the checkpoint; a crash leaves the old one or the new one.

    Args:
        path: The file.
        learner: What ``Learner.state_dict`` returned.
        run: Counters of the run.

    Raises:
        UserError: The system refuses, such as on a full disk; the old checkpoint is still there.
    """
    buffer = io.BytesIO()
    torch.save({"format": FORMAT, "version": VERSION, "learner": learner, "run": run}, buffer)
    sealed = seal_zip(buffer.getvalue())
    write_atomically(path, lambda file: file.write(sealed) and None)


def load_checkpoint(path: Path) -> dict[str, Any] | None:
    """Read a checkpoint onto the CPU.

    Args:
        path: The file.

    Returns:
        Its ``learner`` and ``run``, or None if no epoch was finished.

    Raises:
        UserError: It is damaged, or of another version.
    """
    if not path.exists():
        return None
    sealed = read_file(path, _KIND)
    check_seal(sealed, path, _KIND)
    state: dict[str, Any] = torch.load(io.BytesIO(sealed), map_location="cpu", weights_only=True)
    if (state.get("format"), state.get("version")) != (FORMAT, VERSION):
        raise UserError(
            f"{path} is a {state.get('format')} of version {state.get('version')}; this release "
            f"reads version {VERSION} of {FORMAT}"
        )
    return state
