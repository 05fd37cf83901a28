"""Copies of folders that behave like the originals, with valid notes in their locks."""

from __future__ import annotations

import json
from pathlib import Path

from iher_robot.storage.files.checksum import dump_checked


def as_if_left_there(copy: Path) -> Path:
    """Rewrite the notes in the locks of a copy, which name the inodes of the original.

    Args:
        copy: A copy of a folder, with complete notes.
    """
    for lock in copy.rglob("*.lock"):
        if text := lock.read_text().strip("\0 \n"):
            note = json.loads(text) | {"inode": lock.stat().st_ino}
            note.pop("sha256")
            lock.write_bytes(dump_checked(note))
    return copy
