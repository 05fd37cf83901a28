"""Clocks, passed in so that tests and simulations need not sleep."""

from __future__ import annotations

import time
from typing import Protocol, runtime_checkable


@runtime_checkable
class Clock(Protocol):
    """A monotonic clock. Only differences of its times on one machine have a meaning."""

    def now_ns(self) -> int:
        """Return the time in nanoseconds."""
        ...

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Return once `now_ns` has reached the deadline; at once if it has passed."""
        ...


class MonotonicClock:
    """The machine's monotonic clock."""

    def now_ns(self) -> int:
        """Return the machine's monotonic time in nanoseconds."""
        return time.monotonic_ns()

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Sleep until the deadline has passed."""
        while (left := deadline_ns - time.monotonic_ns()) > 0:
            time.sleep(left / 1e9)


class SimulatedClock:
    """A clock that only moves when it is advanced, so that a paused simulation is never stale."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        """Return the simulated time in nanoseconds."""
        return self._now_ns

    def advance_ns(self, duration_ns: int) -> None:
        """Advance the clock.

        Args:
            duration_ns: Time to add, 0 or more.

        Raises:
            ValueError: If the duration is negative.
        """
        if duration_ns < 0:
            raise ValueError(f"duration_ns is {duration_ns}, allowed: 0 or more")
        self._now_ns += duration_ns

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Jump to the deadline if it lies ahead."""
        self._now_ns = max(self._now_ns, deadline_ns)
