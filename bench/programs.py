"""Child processes of benchmarks: iher-robot commands that end with the benchmark."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def program(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Run an iher-robot command as a child process; SIGTERM ends it in order."""
    command = [sys.executable, "-m", "iher_robot", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=60.0)


@contextmanager
def host(memory: Path) -> Iterator[tuple[str, int]]:
    """Serve a simulated robot; yield its endpoint and the host's process."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with program("serve", "--listen", endpoint, "--memory", str(memory)) as process:
        assert process.stdout is not None
        if not any(line.startswith("serving") for line in process.stdout):
            raise SystemExit("the host did not start; try it by hand: iher-robot serve")
        yield endpoint, process.pid
