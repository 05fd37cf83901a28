"""Contender sbx (JAX): DDPG with ``HerReplayBuffer``, in a separate process.

The processes take turns, so that the threads of torch and of JAX do not disturb each other.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import torch

from bench.speed.comparison import Contender
from bench.speed.precision import Precision
from bench.speed.settings import Settings

NAME = "sbx"
NOT_INSTALLED = "not installed"


class Absent:
    """Contender where sbx is not installed."""

    def contender(self, _precision: Precision, _batch: int, _count: int) -> Contender:
        return Contender(NAME, None, NOT_INSTALLED)


class Agent:
    """An agent in another process.

    Args:
        process: Process of ``bench.speed.sbx_worker``.
        device: Device of our learners.
    """

    def __init__(self, process: subprocess.Popen[str], device: str) -> None:
        self._process = process
        self._about = self._answer()
        self._device = device

    def contender(self, precision: Precision, batch: int, count: int) -> Contender:
        """Contender that takes a number of updates."""
        request = {"precision": precision.name, "batch": batch, "count": count}

        def measure(_: int) -> float:
            assert self._process.stdin is not None
            print(json.dumps(request), file=self._process.stdin, flush=True)
            return float(self._answer()["rate"])

        measure(0)  # warm-up: compilation
        return Contender(NAME, measure, self._note(precision))

    def _note(self, precision: Precision) -> str:
        notes = []
        if self._about["platform"] != self._device:
            notes.append(f"on {self._about['platform']}, the only device that JAX finds")
        if precision.products != torch.float32 and not self._about["bf16"]:
            notes.append("in fp32, XLA supports no bf16 here")
        return "; ".join(notes)

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit("sbx ended early; its output is above")
        answer: dict[str, Any] = json.loads(line)
        return answer


@contextmanager
def agent(settings: Settings, hidden: Sequence[int]) -> Iterator[Agent | Absent]:
    """Start the process and end it."""
    if importlib.util.find_spec("sbx") is None:
        yield Absent()
        return
    options = {
        "hidden": list(hidden),
        "threads": settings.threads,
        "quick": settings.quick,
        "device": settings.device.type,
    }
    environment = os.environ | {
        "XLA_FLAGS": f"--xla_cpu_multi_thread_eigen={str(settings.threads > 1).lower()}",
        "XLA_PYTHON_CLIENT_PREALLOCATE": "false",
    }
    if settings.device.type == "cpu":
        environment["JAX_PLATFORMS"] = "cpu"
    command = [sys.executable, "-m", "bench.speed.sbx_worker", json.dumps(options)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
    ) as process:
        try:
            yield Agent(process, settings.device.type)
        finally:
            assert process.stdin is not None
            process.stdin.close()  # it ends at the end of its input
