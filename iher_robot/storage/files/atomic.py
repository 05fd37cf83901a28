"""Atomic writes of files and folders: a crash leaves the old content or the new one."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from iher_robot.errors import UserError

TEMPORARY_SUFFIX = ".tmp"


def write_atomically(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Replace a file in one step; a crash leaves the old file or the new one.

    Args:
        path: The file to write or replace.
        write: Writes the content to the open file.

    Raises:
        UserError: The system refuses, such as on a full disk; the old file is still there.
    """
    temporary = path.with_name(f".{path.name}{TEMPORARY_SUFFIX}")
    try:
        with temporary.open("wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
        sync_directory(path.parent)
    except OSError as error:
        with suppress(OSError):
            temporary.unlink()
        raise UserError(f"cannot write {path}: {error.strerror or error}") from error
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def sync_directory(path: Path) -> None:
    """Make the names in a folder durable: without this a power cut may undo a rename."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def read_file(path: Path, kind: str) -> bytes:
    """Read a whole file that a user named.

    Args:
        path: The file.
        kind: Name of its kind, such as ``"policy file"``.

    Raises:
        UserError: It is missing, a folder, or unreadable.
    """
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise UserError(f"there is no {kind} at {path}") from None
    except IsADirectoryError:
        raise UserError(f"{path} is a folder, not a {kind}") from None
    except OSError as error:
        raise UserError(f"cannot read {kind} {path}: {error.strerror or error}") from error


@contextmanager
def write_folder(path: Path) -> Iterator[Path]:
    """Create or replace a folder in one step; if the block fails, the old folder stays.

    Args:
        path: The folder. Missing parents are created.

    Yields:
        An empty folder, which is renamed to ``path`` when the block ends.

    Raises:
        UserError: The system refuses, such as on a full disk.
    """
    created = [parent for parent in path.parents if not parent.exists()]
    scratch: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Hidden, so that listings of the parent skip it.
        scratch = Path(tempfile.mkdtemp(TEMPORARY_SUFFIX, f".{path.name}-", path.parent))
        new = scratch / "new"
        new.mkdir()  # with default permissions; those of `scratch` are tighter
        yield new
        _sync_tree(new)
        _put_in_place(new, path, aside=scratch / "old")
        created = []
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        if scratch is not None:
            shutil.rmtree(scratch, ignore_errors=True)
        for parent in created:
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


def _sync_tree(folder: Path) -> None:
    """Flush every file and folder to the disk."""
    for parent, _, names in os.walk(folder):
        for name in names:
            with (Path(parent) / name).open("rb") as file:
                os.fsync(file.fileno())
        sync_directory(Path(parent))
