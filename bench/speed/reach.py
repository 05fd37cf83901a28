"""Total time to a solved Reach: a training run as a process, from start to end.

It ends when two evaluations in a row reach 98 %. Each round has its own seed.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from bench.asynchronous import solved_row
from bench.speed.comparison import Comparison, Contender, Kind
from bench.speed.settings import Settings

SUCCESS = 0.98


@contextmanager
def comparisons(settings: Settings) -> Iterator[list[Comparison]]:
    """Time and peak memory of the same runs."""

    @cache
    def run(seed: int) -> tuple[float, float]:
        return train(settings, seed)

    def of_both(work: str, unit: str, kind: Kind, part: int) -> Comparison:
        ours = Contender("iher_robot", lambda seed: run(seed)[part])
        return Comparison("reach", work, unit, kind, (ours,), at_most_rounds=3)

    yield [
        of_both("Reach solved, from start to end of the process", "s", Kind.SECONDS, 0),
        of_both("Reach solved, most memory of the process", "MB", Kind.AMOUNT, 1),
    ]


def train(settings: Settings, seed: int) -> tuple[float, float]:
    """Seconds and 10^6 bytes of one run."""
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "run"
        command = [sys.executable, "-m", "iher_robot", "train", "--driver", "mujoco"]
        command += ["--robot", "fetch-mocap", "--task", "reach", "--preset", "default"]
        command += ["--seed", str(seed), "--device", settings.device.type]
        command += ["--until-success", str(SUCCESS), "--set", "evaluation.final_episodes=0"]
        command += ["--set", f"threads={settings.threads}", "--out", str(out), "--quiet"]
        if settings.quick:
            command += ["--budget-minutes", "0.04", "--set", "evaluation.episodes=1"]
        started = time.perf_counter()
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - started
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise SystemExit(f"training ended with {process.returncode}")
        rows = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    if not settings.quick and not solved_row(rows, SUCCESS):
        raise SystemExit(f"Reach was not solved with seed {seed}, so there is no time to report")
    return seconds, usage.ru_maxrss * 1024 / 1e6
