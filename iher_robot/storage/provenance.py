"""Provenance of a result: command, versions, commit and machine."""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import subprocess
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from iher_robot.storage.files.atomic import read_file, write_atomically
from iher_robot.storage.files.checksum import add_checksum, load_checked

UNKNOWN = "unknown"
_DISTRIBUTIONS = ("iher-robot", "torch", "mujoco", "gymnasium-robotics", "numpy")


def collect_provenance(command: Sequence[str], seed: int, started: datetime) -> dict[str, Any]:
    """Describe this process.

    Args:
        command: The command line.
        seed: The run's seed.
        started: Start time.

    Returns:
        JSON values: ``command``, ``seed``, ``started``, ``versions``, ``commit``, ``dirty`` and
        ``machine``.
    """
    return {
        "command": list(command),
        "seed": seed,
        "started": started.isoformat(timespec="seconds"),
        "versions": versions(),
        **commit(Path(__file__).parent),
        "machine": machine(),
    }


def write_provenance(path: Path, provenance: dict[str, Any]) -> None:
    """Write the provenance of a run, or add that of a resumption under ``resumed``.

    Args:
        path: The file.
        provenance: From ``collect_provenance``.

    Raises:
        UserError: The file is there but damaged, or cannot be written.
    """
    document = provenance
    if path.exists():
        document = read_provenance(path)
        document.setdefault("resumed", []).append(provenance)
    text = json.dumps(add_checksum(document), indent=2) + "\n"
    write_atomically(path, lambda file: file.write(text.encode()))


def read_provenance(path: Path) -> dict[str, Any]:
    """Read the provenance of a run.

    Raises:
        UserError: It is missing or damaged.
    """
    return load_checked(read_file(path, "provenance file"), path, "provenance file")


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that affect results."""
    found = {"python": platform.python_version()}
    for name in _DISTRIBUTIONS:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = UNKNOWN
    return found


def commit(folder: Path) -> dict[str, Any]:
    """Git commit of a package's folder.

    Args:
        folder: The folder.

    Returns:
        ``commit``, ``"unknown"`` if git does not track the folder; and ``dirty``, whether
        tracked files differ from it, None if unknown.
    """
    unknown = {"commit": UNKNOWN, "dirty": None}
    # A package installed inside another repository does not have that repository's commit.
    if not _git(folder, "ls-files"):
        return unknown
    revision = _git(folder, "rev-parse", "HEAD")
    status = _git(folder, "status", "--porcelain", "--untracked-files=no")
    if revision is None or status is None:
        return unknown
    return {"commit": revision, "dirty": bool(status)}


def machine() -> dict[str, Any]:
    """CPU model, usable cores, GPU and operating system."""
    import torch

    return {
        "cpu": _cpu_model(),
        "cores": len(os.sched_getaffinity(0)),
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
        "system": f"{platform.system()} {platform.machine()}",
    }


def _cpu_model() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or UNKNOWN


def _git(folder: Path, *arguments: str) -> str | None:
    command = ["git", "-C", str(folder), *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=False)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() if done.returncode == 0 else None
