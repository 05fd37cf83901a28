"""A file that one process holds, with a note in it of how far its holder got."""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from drivers.closing import Closing
from iher_robot.errors import UserError
from iher_robot.storage.files.checksum import open_line, seal_line

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
_SIZE = 1024
_LOOK_S = 0.1


class FileHeld(UserError):
    """Another process holds a file."""


class LockFile(Closing):
    """One process at a time holds it, until it closes the file or dies.

    What it notes is with the system at once and never waits for a disk: after a crash of the
    program it is exact, after a crash of the machine it counts for nothing.

    Attributes:
        note: What the last holder noted; empty if nothing, if the machine was started since, if
            it is damaged, or the file a copy.
    """

    def __init__(self, path: Path, in_use: str) -> None:
        """Take hold of a file, or make it.

        Args:
            path: The file.
            in_use: The sentence for a user when another process holds it.

        Raises:
            FileHeld: It does.
            UserError: The file cannot be opened.
        """
        self.path = path
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise UserError(f"cannot open {path}: {error.strerror}") from error
        self._open = True
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.close()
            raise FileHeld(in_use) from None
        self.note = self._read()

    def write(self, **note: Any) -> None:
        """Replace the note.

        Args:
            note: Plain values, half a kilobyte at most.

        Raises:
            UserError: The system refuses, such as on a full disk.
        """
        mine = {"boot": _boot(), "inode": os.fstat(self._descriptor).st_ino, "pid": os.getpid()}
        line = seal_line(mine | note).ljust(_SIZE)
        assert len(line) == _SIZE, len(line)
        try:
            os.pwrite(self._descriptor, line, 0)  # never shorter: a full disk keeps the old one
        except OSError as error:
            raise UserError(f"cannot write {self.path}: {error.strerror}") from error

    def fileno(self) -> int:
        """Descriptor of the file: a process that inherits it holds the file, too."""
        return self._descriptor

    def close(self) -> None:
        """Let go of the file; closing twice does nothing."""
        if self._open:
            self._open = False
            os.close(self._descriptor)

    def _read(self) -> Mapping[str, Any]:
        return read_note(self.path)


def hold_patiently(
    path: Path, in_use: str, patience_s: float, give_up: Callable[[], bool] = lambda: False
) -> LockFile:
    """Hold a file, once its holder has let go of it.

    Args:
        path: The file.
        in_use: The sentence for a user if its holder does not.
        patience_s: How long to wait.
        give_up: Whether nobody wants it any more.

    Raises:
        FileHeld: It is still held.
        UserError: The file cannot be opened.
    """
    deadline = time.monotonic() + patience_s
    while True:
        try:
            return LockFile(path, in_use)
        except FileHeld:
            if time.monotonic() > deadline or give_up():
                raise
            time.sleep(_LOOK_S)


def is_held(path: Path) -> bool:
    """Whether a process holds a file; nothing is written, and a file that is not there is not."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


def read_note(path: Path) -> Mapping[str, Any]:
    """What the holder of a file noted last, see ``LockFile.note``; it may be holding it still."""
    try:
        note = open_line(path.read_bytes()[:_SIZE].rstrip(), path, "lock file")
        own = (note.get("boot"), note.get("inode")) == (_boot(), path.stat().st_ino)
    except (OSError, UserError):
        return {}
    return note if own else {}


@cache
def _boot() -> str:
    return _BOOT_ID.read_text().strip()
