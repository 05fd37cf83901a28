"""A host in separate processes, started by ``iher-robot serve``."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Self

from drivers.closing import Closing
from drivers.remote import ZenohDriver, link_options

START_S = 60.0
PATIENT = ("--deadman", "2")
"""Options for tests that do not test the deadman: a busy machine may delay a client."""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class ServedRobot(Closing):
    """A host on its own port, started and ended by a ``with`` block.

    Attributes:
        endpoint: Where it listens.
        memory: Folder that outlives it.
        output: Lines that it printed.
        drivers: Clients that were made by `driver`.
    """

    def __init__(
        self, memory: Path, *options: str, port: int | None = None, path: str = ""
    ) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port() if port is None else port}"
        self.memory = memory
        self.output: list[str] = []
        self.drivers: list[ZenohDriver] = []
        self._options = options
        self._path = path or os.environ.get("PYTHONPATH", "")
        self._process: subprocess.Popen[str] | None = None

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    def child(self, name: str) -> int:
        """Return the pid of ``run_robot`` or ``run_gateway``, in the order of their start."""
        children = Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text().split()
        spawned = [int(child) for child in children if b"spawn_main" in _command_line(int(child))]
        return sorted(spawned)[("run_robot", "run_gateway").index(name)]

    def driver(self, scene: str = "push", **options: object) -> ZenohDriver:
        """Make a client whose timeouts bear a busy machine."""
        settings: dict[str, object] = {"connect": [self.endpoint], "timeout_s": 2.0}
        self.drivers.append(ZenohDriver(link_options(settings | options), scene))
        return self.drivers[-1]

    def start(self) -> None:
        command = [sys.executable, "-m", "iher_robot", "serve", "--listen", self.endpoint]
        command += ["--memory", str(self.memory), *self._options]
        self._process = subprocess.Popen(
            command,
            env={**os.environ, "PYTHONPATH": self._path},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        ready = threading.Event()
        threading.Thread(target=self._read, args=(ready,), daemon=True).start()
        served = ready.wait(START_S) and any(line.startswith("serving") for line in self.output)
        if not served:
            self.kill()
            raise AssertionError(f"the host did not start: {self.output}")

    def signal(self, number: int) -> None:
        assert self._process is not None
        self._process.send_signal(number)

    def wait(self, timeout_s: float = 20.0) -> int:
        assert self._process is not None
        return self._process.wait(timeout_s)

    def kill(self) -> None:
        """Kill the process, without an orderly end."""
        assert self._process is not None
        self._process.kill()
        self._process.wait(10.0)

    def __enter__(self) -> Self:
        self.start()
        return self

    def close(self) -> None:
        assert self._process is not None
        if self._process.poll() is None:
            self.signal(signal.SIGCONT)
            self.signal(signal.SIGTERM)
            try:
                self.wait()
            except subprocess.TimeoutExpired:
                self.kill()

    def _read(self, ready: threading.Event) -> None:
        assert self._process is not None and self._process.stdout is not None  # noqa: PT018
        for line in self._process.stdout:
            self.output.append(line.rstrip())
            if line.startswith("try"):
                ready.set()
        ready.set()


def eventually(condition: Callable[[], bool], timeout_s: float = 10.0) -> bool:
    """Wait for a condition; return whether it came true in time."""
    tick = threading.Event()
    for _ in range(round(timeout_s / 0.02)):
        if condition():
            return True
        tick.wait(0.02)
    return condition()


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return b"Z" not in Path(f"/proc/{pid}/stat").read_bytes().rsplit(b")", 1)[1][:3]


def _command_line(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""
