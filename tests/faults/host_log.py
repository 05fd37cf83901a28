"""Reader of the host's tick log, while it is being written."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.faults.violation import Violation

_SETTLED_S = 10.0


@dataclass(frozen=True)
class LoggedTick:
    """A tick as the robot's side saw it.

    Attributes:
        seq: The robot's tick counter at its end.
        token: The lease in force, 0 for none.
        armed: Whether the command gate was open.
        commanded: Whether a command was in force in it.
        host_ns: When it ended, on this machine's monotonic clock.
    """

    seq: int
    token: int
    armed: bool
    commanded: bool
    host_ns: int


class HostLog:
    """Tick log of one start of a host.

    Attributes:
        ticks: Ticks so far, in order.
    """

    def __init__(self, path: Path) -> None:
        self.ticks: list[LoggedTick] = []
        self._file = path.open("rb")
        self._part = b""
        self._boots: set[str] = set()

    def read(self) -> Sequence[LoggedTick]:
        """Return the ticks that were logged since the last call.

        Raises:
            Violation: Armed ticks are missing, or the host was restarted.
        """
        *lines, self._part = (self._part + self._file.read()).split(b"\n")
        before = len(self.ticks)
        for line in lines:
            fields = json.loads(line)
            self._boots.add(fields["boot"])
            tick = LoggedTick(
                fields["seq"],
                fields["token"],
                fields["armed"],
                fields["applied"] is not None,
                fields["host_ns"],
            )
            last = self.ticks[-1] if self.ticks else None
            if last is not None and (
                tick.seq <= last.seq or (tick.armed and last.armed and tick.seq != last.seq + 1)
            ):
                raise Violation(f"the host's log goes from {last} to {tick}")
            self.ticks.append(tick)
        if len(self._boots) > 1:
            raise Violation("the host was restarted during the run")
        return self.ticks[before:]

    def settle(self) -> None:
        """Wait until the robot is disarmed, after which no command of a lost client can follow."""
        asked_ns = time.monotonic_ns()
        while time.monotonic_ns() < asked_ns + _SETTLED_S * 1e9:
            self.read()
            if self.ticks and self.ticks[-1].host_ns > asked_ns and not self.ticks[-1].armed:
                return
            time.sleep(0.02)
        raise Violation(f"the robot is still armed {_SETTLED_S:g} s after its client is gone")
