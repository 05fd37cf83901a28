"""Lock file of one process, with a note of its progress that survives its crash."""

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
from iher_robot.storage.files.checksum import dump_checked, load_checked

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
_SIZE = 1024
_POLL_S = 0.1


class FileHeld(UserError):
    """Another process holds the lock."""


class LockFile(Closing):
    """Exclusive lock on a file, held until the process closes it or dies.

    The note goes to the page cache and is never flushed to the disk: after a crash of the process
    it is exact, after a crash of the machine it is discarded.

    Attributes:
        note: Note of the last holder. Empty if there is none, the machine has rebooted since, the
            file is damaged, or the file is a copy.
    """

    def __init__(self, path: Path, in_use: str) -> None:
        """Lock a file, which is created if it does not exist.

        Args:
            path: The file.
            in_use: Message if another process holds the lock.

        Raises:
            FileHeld: Another process holds the lock.
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
            note: JSON values, at most half a kilobyte.

        Raises:
            UserError: The system refuses, such as on a full disk.
        """
        mine = {"boot": _boot_id(), "inode": os.fstat(self._descriptor).st_ino, "pid": os.getpid()}
        line = dump_checked(mine | note).ljust(_SIZE)
        assert len(line) == _SIZE, len(line)
        try:
            os.pwrite(self._descriptor, line, 0)  # same length: a full disk keeps the old
        except OSError as error:
            raise UserError(f"cannot write {self.path}: {error.strerror}") from error

    def fileno(self) -> int:
        """File descriptor; a process that inherits it holds the lock too."""
        return self._descriptor

    def close(self) -> None:
        """Release the lock; closing twice does nothing."""
        if self._open:
            self._open = False
            os.close(self._descriptor)

    def _read(self) -> Mapping[str, Any]:
        return read_note(self.path)


def wait_for_lock(
    path: Path, in_use: str, timeout_s: float, give_up: Callable[[], bool] = lambda: False
) -> LockFile:
    """Lock a file, waiting until its holder releases it.

    Args:
        path: The file.
        in_use: Message if the timeout expires.
        timeout_s: Longest time to wait.
        give_up: Polled while waiting; True stops it.

    Raises:
        FileHeld: It is still locked.
        UserError: The file cannot be opened.
    """
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            return LockFile(path, in_use)
        except FileHeld:
            if time.monotonic() > deadline or give_up():
                raise
            time.sleep(_POLL_S)


def is_locked(path: Path) -> bool:
    """Whether a process holds the lock; a missing file is not created."""
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
    """Last note in a lock file, see ``LockFile.note``; the holder may still be writing."""
    try:
        note = load_checked(path.read_bytes()[:_SIZE].rstrip(), path, "lock file")
        own = (note.get("boot"), note.get("inode")) == (_boot_id(), path.stat().st_ino)
    except (OSError, UserError):
        return {}
    return note if own else {}


@cache
def _boot_id() -> str:
    return _BOOT_ID.read_text().strip()
