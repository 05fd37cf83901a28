"""A learner in its own process group, to be killed."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from drivers.closing import Closing
from tests.faults.violation import Violation


class Learner(Closing):
    """One process of a run.

    Attributes:
        command: Its command line.
        output: File with its output.
    """

    def __init__(
        self, options: Sequence[str], output: Path, environment: Mapping[str, str]
    ) -> None:
        self.command = [sys.executable, "-m", "iher_robot", "train", *options]
        self.output = output
        with output.open("wb") as file:
            self._process = subprocess.Popen(
                self.command,
                stdout=file,
                stderr=subprocess.STDOUT,
                env={**os.environ, **environment},
                start_new_session=True,
            )

    @property
    def runs(self) -> bool:
        return self._process.poll() is None

    def wait(self, timeout_s: float) -> int | None:
        """Return the exit code; None after the timeout."""
        try:
            return self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return None

    def kill(self) -> None:
        """Kill the whole group, if it still runs."""
        if self.runs:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait(30.0)

    def printed(self) -> str:
        return self.output.read_text(errors="replace")

    def require_ending(self, expected: int, pattern: str = "") -> None:
        """Check the exit code and the output.

        Args:
            expected: The exit code.
            pattern: Regular expression that the output must match.

        Raises:
            Violation: The code or the output differ, or there is a traceback.
        """
        code, printed = self.wait(0.0), self.printed()
        if code == expected and re.search(pattern, printed) and "Traceback" not in printed:
            return
        wanted = f"expected {expected}" + (f" and {pattern!r}" if pattern else "")
        raise Violation(f"the learner ended with {code}, {wanted}; it printed:\n{printed}")

    def close(self) -> None:
        self.kill()
