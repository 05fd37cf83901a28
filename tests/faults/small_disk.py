"""A disk that can be filled: a small file system in memory."""

from __future__ import annotations

import contextlib
import errno
import os
import subprocess
from pathlib import Path

from drivers.closing import Closing

_BLOCK = b"\0" * (1 << 16)


class SmallDisk(Closing):
    """A small file system, mounted until it is closed.

    Attributes:
        folder: Mount point.
    """

    def __init__(self, folder: Path, size_mb: int = 64) -> None:
        """Mount the file system.

        Raises:
            OSError: This system does not permit it.
        """
        folder.mkdir(parents=True, exist_ok=True)
        command = ["mount", "-t", "tmpfs", "-o", f"size={size_mb}m", "tmpfs", str(folder)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise OSError(f"{' '.join(command)}: {done.stderr.strip()}")
        self.folder = folder

    def fill(self) -> None:
        """Fill the disk to the last byte."""
        with (self.folder / "filler").open("ab", buffering=0) as file:
            for size in (len(_BLOCK), 1):
                try:
                    while file.write(_BLOCK[:size]):
                        pass
                except OSError as error:
                    if error.errno != errno.ENOSPC:
                        raise

    def clear(self) -> None:
        """Free the space."""
        (self.folder / "filler").unlink(missing_ok=True)

    def close(self) -> None:
        subprocess.run(["umount", "--lazy", str(self.folder)], check=False)


def why_no_disk(scratch: Path) -> str:
    """Why no small disk can be mounted here; empty if one can."""
    try:
        SmallDisk(scratch / "probe", 1).close()
    except OSError as error:
        return str(error)
    return ""


def enter_namespace(arguments: list[str]) -> None:
    """Restart this program in a namespace where it may mount, if the system permits that.

    Args:
        arguments: Arguments of the program.
    """
    inside = "IHER_FAULTS_NAMESPACE"
    if inside in os.environ:
        return
    command = ["unshare", "--user", "--map-root-user", "--mount"]
    with contextlib.suppress(OSError):
        if subprocess.run([*command, "true"], capture_output=True, check=False).returncode == 0:
            os.execvpe(command[0], [*command, *arguments], {**os.environ, inside: "1"})
