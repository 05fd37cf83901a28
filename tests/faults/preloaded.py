"""Libraries to preload into a program and its children, which falsify clock or disk."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

_LOOK = """
import time
begun, seen = time.monotonic(), []
while time.monotonic() < begun + 3.0:
    seen.append(time.time() - time.monotonic())
    time.sleep(0.01)
print(max(seen) - min(seen))
"""


def build_library(name: str, folder: Path) -> Path:
    """Compile a library.

    Args:
        name: Name of the source in this folder.
        folder: Folder of the library.

    Raises:
        OSError: There is no C compiler here.
    """
    library = folder / f"{name}.so"
    source = Path(__file__).with_name(f"{name}.c")
    command = ["cc", "-O1", "-shared", "-fPIC", "-o", str(library), str(source), "-ldl"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise OSError(f"{' '.join(command)}: {done.stderr.strip()}")
    return library


def build_jumping_clock(folder: Path) -> Path:
    """Compile the clock that jumps, and check that it jumps.

    Args:
        folder: Folder of the library.

    Raises:
        OSError: There is no C compiler here, or the clock does not jump.
    """
    library = build_library("jumping_clock", folder)
    found = subprocess.run(
        [sys.executable, "-c", _LOOK],
        env={**os.environ, "LD_PRELOAD": str(library)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    if float(found) < 60.0:
        raise OSError(f"the clock under {library} moved by {float(found):.3f} s only")
    return library
