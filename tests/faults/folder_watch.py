"""Watch a folder with inotify: also files that exist for a millisecond."""

from __future__ import annotations

import ctypes
import os
import select
import struct
from collections.abc import Iterator
from pathlib import Path

from drivers.closing import Closing

_CREATED, _MODIFIED, _MOVED_HERE = 0x100, 0x2, 0x80
_EVENT = struct.Struct("iIII")
_libc = ctypes.CDLL(None, use_errno=True)


class FolderWatch(Closing):
    """Reports files that are created, written or renamed in a folder."""

    def __init__(self, folder: Path) -> None:
        self._descriptor = _libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        mask = _CREATED | _MODIFIED | _MOVED_HERE
        if _libc.inotify_add_watch(self._descriptor, os.fsencode(folder), mask) < 0:
            raise OSError(ctypes.get_errno(), f"cannot watch {folder}")

    def wait(self, timeout_s: float) -> list[str]:
        """Return the names of changed files; empty after the timeout.

        Args:
            timeout_s: Longest time to wait.
        """
        if not select.select([self._descriptor], [], [], timeout_s)[0]:
            return []
        return list(_names(os.read(self._descriptor, 1 << 16)))

    def close(self) -> None:
        os.close(self._descriptor)


def _names(events: bytes) -> Iterator[str]:
    at = 0
    while at < len(events):
        _, _, _, length = _EVENT.unpack_from(events, at)
        at += _EVENT.size
        yield events[at : at + length].rstrip(b"\0").decode()
        at += length
