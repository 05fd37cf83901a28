"""Folders that are written whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from iher_robot.errors import UserError
from iher_robot.storage.files.atomic import TEMPORARY_SUFFIX, sync_directory


@contextmanager
def write_folder(path: Path) -> Iterator[Path]:
    """Make or replace a folder; unless the block succeeds, what was there stays as it was.

    Args:
        path: The folder; those above it are made if they do not exist.

    Yields:
        An empty folder beside it, which takes its place when the block ends.

    Raises:
        UserError: The system refuses, such as on a full disk.
    """
    made = [parent for parent in path.parents if not parent.exists()]
    scratch: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Hidden: whoever lists the folders beside it meanwhile passes it over.
        scratch = Path(tempfile.mkdtemp(TEMPORARY_SUFFIX, f".{path.name}-", path.parent))
        new = scratch / "new"
        new.mkdir()  # with the rights of any new folder, which `scratch` has not
        yield new
        _sync(new)
        _put_in_place(new, path, aside=scratch / "old")
        made = []
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        if scratch is not None:
            shutil.rmtree(scratch, ignore_errors=True)
        for parent in made:
            with suppress(OSError):
                parent.rmdir()


def _put_in_place(new: Path, path: Path, *, aside: Path) -> None:
    if path.exists():
        path.rename(aside)
    try:
        new.rename(path)
    except OSError:
        if aside.exists():
            aside.rename(path)
        raise
    sync_directory(path.parent)


def _sync(folder: Path) -> None:
    """Have all of a folder on the disk before it bears its name."""
    for parent, _, names in os.walk(folder):
        for name in names:
            with (Path(parent) / name).open("rb") as file:
                os.fsync(file.fileno())
        sync_directory(Path(parent))
