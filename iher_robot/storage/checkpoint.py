"""Checkpoint of a run, written at the end of an epoch."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from iher_robot.storage.files.torch_file import load_torch_file, save_torch_file

KIND = "checkpoint"
VERSION = 4


def save_checkpoint(path: Path, *, learner: dict[str, Any], run: dict[str, Any]) -> None:
    """Replace the checkpoint atomically.

    Args:
        path: The file.
        learner: State from ``Learner.state_dict``.
        run: Settings, counters and metrics of the run.

    Raises:
        UserError: The system refuses, such as on a full disk; the old checkpoint is still there.
    """
    save_torch_file(path, {"learner": learner, "run": run}, kind=KIND, version=VERSION)


def load_checkpoint(path: Path) -> dict[str, Any] | None:
    """Read a checkpoint onto the CPU.

    Args:
        path: The file.

    Returns:
        ``learner`` and ``run``, or None before the first epoch has ended.

    Raises:
        UserError: The file is damaged, or of another version.
    """
    if not path.exists():
        return None
    return load_torch_file(path, kind=KIND, version=VERSION, oldest=VERSION)
