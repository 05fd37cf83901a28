"""How evenly the control ticks of a robot in real time come."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from drivers import RobotDriver


class TickJitter:
    """Compares the time between two states with the control period, as this process sees it.

    Args:
        driver: The robot. A simulation that is as fast as it can has no jitter.
    """

    def __init__(self, driver: RobotDriver) -> None:
        self._driver = driver
        self._last_ns: int | None = None
        self._off_ms: list[float] = []
        self._missed = 0

    def begin(self) -> None:
        """An episode begins; the state that it begins with may be older than a tick."""
        self._last_ns = None

    def tick(self, elapsed: int) -> None:
        """A state arrived.

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
        """Metrics of the ticks since the last call, which are then forgotten; empty without any."""
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
    """How evenly the ticks of a run came, in words.

    Args:
        rows: Metrics of its epochs.

    Returns:
        One sentence, empty where no tick was measured.
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
