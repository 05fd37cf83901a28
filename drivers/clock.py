"""Clocks, injected so that neither a test nor a simulation has to sleep."""

from __future__ import annotations

import time
from typing import Protocol, runtime_checkable


@runtime_checkable
class Clock(Protocol):
    """A monotonic clock. Its origin means nothing: only differences on one machine do."""

    def now_ns(self) -> int:
        """Return the time in nanoseconds."""
        ...

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Return once `now_ns` has reached the deadline; at once if it has passed."""
        ...


class MonotonicClock:
    """The machine's own clock."""

    def now_ns(self) -> int:
        """Return the machine's monotonic time in nanoseconds."""
        return time.monotonic_ns()

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Sleep until the deadline has passed."""
        while (left := deadline_ns - time.monotonic_ns()) > 0:
            time.sleep(left / 1e9)


class SimulatedClock:
    """Time that passes only when somebody advances it: a paused simulation is never stale."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        """Return the simulated time in nanoseconds."""
        return self._now_ns

    def advance_ns(self, duration_ns: int) -> None:
        """Let time pass.

        Args:
            duration_ns: How much, not negative.

        Raises:
            ValueError: If time would run backwards.
        """
        if duration_ns < 0:
            raise ValueError(f"duration_ns is {duration_ns}, allowed: 0 or more")
        self._now_ns += duration_ns

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Jump to the deadline if it lies ahead."""
        self._now_ns = max(self._now_ns, deadline_ns)
