"""When the ticks of a control loop should end, and how late they do."""

from __future__ import annotations

from collections import deque

import numpy as np

from drivers.clock import Clock

_TIMED_TICKS = 1500


class TickSchedule:
    """Deadlines one control period apart. Ticks that were missed are not made up for.

    Attributes:
        next_ns: When the tick in progress should end, on the host's clock.
    """

    def __init__(self, clock: Clock) -> None:
        """Start without a tick.

        Args:
            clock: The host's.
        """
        self.next_ns = 0
        self._clock = clock
        self._paused = False
        self._late_ms: deque[float] = deque(maxlen=_TIMED_TICKS)
        self._overruns = 0

    def start(self) -> None:
        """Let the first tick begin now."""
        self.next_ns = self._clock.now_ns()

    def begin_tick(self, period_ns: int) -> None:
        """Set the deadline of the tick that begins now."""
        self.next_ns += period_ns

    def pause(self) -> None:
        """Do not measure the tick in progress: a reset or loading a scene takes longer."""
        self._paused = True

    def end_tick(self, period_ns: int, *, paces_itself: bool) -> None:
        """Measure how late a tick ended.

        Args:
            period_ns: The control period.
            paces_itself: Whether the driver, and not this schedule, waits for the end of a tick.
        """
        now_ns = self._clock.now_ns()
        late_ns = now_ns - self.next_ns
        if self._paused:
            self._paused, self.next_ns = False, now_ns
            return
        self._late_ms.append(late_ns / 1e6)
        if late_ns > period_ns:
            self._overruns += 1
        if late_ns > period_ns or paces_itself:
            self.next_ns = now_ns

    def timing(self) -> dict[str, float | int]:
        """Return how late the last ticks ended, for `status`."""
        p50, p99 = np.percentile(self._late_ms, [50, 99]) if self._late_ms else (0.0, 0.0)
        return {
            "tick_late_p50_ms": float(p50),
            "tick_late_p99_ms": float(p99),
            "tick_overruns": self._overruns,
        }
