"""Fixtures of the whole suite."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

WholeRun = Callable[..., Path]


@pytest.fixture(scope="session")
def whole_run(tmp_path_factory: pytest.TempPathFactory) -> WholeRun:
    """Returns the folder of a finished run, by the arguments of `tests.small_runs.run`.

    Each is made once for all workers of pytest-xdist. A test that changes one works on a copy.
    """
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent

    def find(minutes: float, *overrides: str, **options: Any) -> Path:
        from tests.small_runs import run

        arguments = json.dumps([minutes, overrides, options], sort_keys=True)
        name = hashlib.sha256(arguments.encode()).hexdigest()[:16]
        place = folder / "whole-runs" / name
        place.mkdir(parents=True, exist_ok=True)
        with (place / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not (place / "made").exists():
                shutil.rmtree(place / "run", ignore_errors=True)
                run(place / "run", minutes, *overrides, **options)
                (place / "made").touch()
        return place / "run"

    return find
