"""Files that survive a crash: written whole or not at all, and damage shows."""

from __future__ import annotations

import hashlib
import os
import shutil
import struct
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from iher_robot.errors import UserError

TEMPORARY_SUFFIX = ".tmp"

_DIGEST_CHARS = 64
_NO_COMMENT = b"\0\0"
_COMMENT_LENGTH = struct.pack("<H", _DIGEST_CHARS)


def write_atomically(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Replace a file in one step: after a crash the old or the new one is there, whole.

    Args:
        path: The file to write or replace.
        write: Writes the content to the open file it is given.

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
    """Make the names in a folder durable; without this a rename may be lost in a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def read_file(path: Path, kind: str) -> bytes:
    """Read a whole file that a user named.

    Args:
        path: The file.
        kind: What it should be, such as ``"policy file"``.

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


def seal_zip(archive: bytes) -> bytes:
    """Put the SHA-256 of a ZIP archive into its comment.

    What ``np.savez`` and ``torch.save`` write are ZIP archives, and stay readable by their own
    loaders. Their CRCs cover the members, but not names, sizes or the directory.

    Args:
        archive: A ZIP archive without a comment.

    Returns:
        The same archive with the digest of all bytes before the comment.
    """
    if not archive.endswith(_NO_COMMENT):
        raise ValueError("only a ZIP archive without a comment can be sealed")
    body = archive[: -len(_NO_COMMENT)] + _COMMENT_LENGTH
    return body + hashlib.sha256(body).hexdigest().encode()


def check_seal(sealed: bytes, path: Path, kind: str) -> None:
    """Check the digest before any parser sees the bytes.

    Args:
        sealed: The bytes of the file.
        path: Where they are from, for the message.
        kind: What the file should be.

    Raises:
        UserError: A single byte differs from what was sealed, or it never was.
    """
    body, digest = sealed[:-_DIGEST_CHARS], sealed[-_DIGEST_CHARS:]
    if hashlib.sha256(body).hexdigest().encode() != digest:
        raise UserError(f"{path} is no {kind} of iher-robot, or it is truncated or damaged")


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
