"""Timing of a robot in real time: jitter of its control ticks, and idle time between episodes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import ExitStack

import numpy as np

from drivers import RobotDriver
from iher_robot.storage.ledger import Entry, Ledger
from iher_robot.storage.robot_time import RobotTime


class TickJitter:
    """Measures how far the time between two states is off the control period, in this process.

    Args:
        driver: The robot. A simulation that does not keep real time has no jitter.
    """

    def __init__(self, driver: RobotDriver) -> None:
        self._driver = driver
        self._last_ns: int | None = None
        self._off_ms: list[float] = []
        self._missed = 0

    def begin(self) -> None:
        """Begin an episode, whose first state may be older than a tick."""
        self._last_ns = None

    def tick(self, elapsed: int) -> None:
        """Measure the state that arrived.

        Args:
            elapsed: Ticks since the one before.
        """
        if not self._driver.paces_itself:
            return
        now_ns = self._driver.now_ns
        self._missed += elapsed - 1
        if self._last_ns is not None:
            due_ns = self._last_ns + elapsed * self._driver.spec.control_period_ns
            self._off_ms.append(abs(now_ns - due_ns) / 1e6)
        self._last_ns = now_ns

    def take(self) -> dict[str, float]:
        """Return the metrics of the ticks since the last call; empty if there were none."""
        off_ms, missed = self._off_ms, self._missed
        self._off_ms, self._missed = [], 0
        if not off_ms:
            return {}
        p50, p99 = np.percentile(off_ms, [50, 99])
        return {
            "tick_jitter_p50_ms": float(p50),
            "tick_jitter_p99_ms": float(p99),
            "ticks_missed": missed,
        }


def describe_jitter(rows: Iterable[Mapping[str, float]]) -> str:
    """Describe the jitter of a run.

    Args:
        rows: Metrics of its epochs.

    Returns:
        A sentence; empty if no tick was measured.
    """
    measured = [row for row in rows if "tick_jitter_p99_ms" in row]
    if not measured:
        return ""
    p50, p99 = ([row[f"tick_jitter_{name}_ms"] for row in measured] for name in ("p50", "p99"))
    missed = sum(round(row["ticks_missed"]) for row in measured)
    return (
        f"off the control period by {np.median(p50):.2f} ms in the median and {max(p99):.2f} ms at "
        f"the 99th percentile of the worst epoch, {missed:,} missed"
    )


_AHEAD_S = 10.0
"""Idle time that is charged ahead."""
_RESERVED_S = 60.0
"""Idle time that is reserved at once."""


class IdleMeter:
    """Charges the time between two episodes of a robot in real time to the account ``idle``.

    Args:
        driver: The robot. A simulation that does not keep real time has no idle time.
        ledger: Accounts of the run.
    """

    def __init__(self, driver: RobotDriver, ledger: Ledger) -> None:
        self._driver = driver
        self._ledger = ledger
        self._period_s = driver.spec.control_period_s
        self._stack = ExitStack()
        self._entry: Entry | None = None
        self._since_ns = 0

    def begin(self) -> None:
        """Start idling."""
        if self._driver.paces_itself and self._entry is None:
            self._since_ns = self._driver.now_ns
            reserved = RobotTime.from_seconds(_RESERVED_S, self._period_s).ticks
            self._entry = self._stack.enter_context(
                self._ledger.reserve("idle", reserved, counted=True)
            )
            self.note()

    def note(self) -> None:
        """Charge the idle time so far, and some ahead, so that a crash leaves it counted."""
        if self._entry is None:
            return
        noted = self._ticks() + RobotTime.from_seconds(_AHEAD_S, self._period_s).ticks
        if noted > self._entry.reserved_ticks:
            self.end()
            self.begin()
        else:
            self._entry.begin(noted)

    def end(self) -> None:
        """Stop idling, and settle the time."""
        entry, self._entry = self._entry, None
        if entry is not None:
            entry.settle(self._ticks())
            self._stack.close()

    def _ticks(self) -> int:
        return RobotTime.from_ns(self._driver.now_ns - self._since_ns, self._period_s).ticks
