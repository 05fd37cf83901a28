"""Reconnect policy: retries with growing pauses until a robot is back, or a timeout expires."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path

from drivers import Clock, DriverError, FaultLatched, LeaseRefused, RobotDriver
from iher_robot.errors import UserError

FIRST_PAUSE_S = 0.5
LONGEST_PAUSE_S = 5.0
_GROWTH = 2.0


class ReconnectPolicy:
    """Waits between attempts to reach a robot, in pauses that grow.

    Args:
        driver: The robot.
        minutes: Timeout until it is back.
        run: The run folder, for advice in messages.
        announce: Called with lines for the user.
        clock: This machine's clock, not the robot's.
    """

    def __init__(
        self,
        driver: RobotDriver,
        minutes: float,
        run: Path,
        announce: Callable[[str], None],
        clock: Clock,
    ) -> None:
        self._driver = driver
        self._minutes = minutes
        self._run = run
        self._announce = announce
        self._clock = clock
        self._since_ns: int | None = None
        self._pause_s = FIRST_PAUSE_S

    def wait(self, error: DriverError) -> None:
        """Pause before the next attempt.

        Args:
            error: Why the last one failed.

        Raises:
            UserError: The reconnect timeout expired.
        """
        now_ns = self._clock.now_ns()
        if self._since_ns is None:
            self._since_ns = now_ns
        left_s = self._minutes * 60.0 - (now_ns - self._since_ns) / 1e9
        if left_s <= 0.0:
            raise UserError(
                f"{self._what_happened(error)}, and {self._minutes:g} minutes of waiting "
                "(patience_minutes) changed nothing; nothing recorded is lost, continue with: "
                f"iher-robot train --resume {shlex.quote(str(self._run))}"
            ) from error
        pause_s = min(self._pause_s, left_s)
        self._announce(
            f"{self._what_happened(error)}; trying again in {pause_s:.2g} s, for up to "
            f"{left_s / 60.0:.1f} minutes"
        )
        self._pause_s = min(_GROWTH * self._pause_s, LONGEST_PAUSE_S)
        self._clock.sleep_until_ns(now_ns + round(pause_s * 1e9))

    def end(self) -> None:
        """Note that the robot is back; the next loss has the whole timeout again."""
        if self._since_ns is not None:
            self._announce(f"{self._driver.spec.name} is back, going on")
        self._since_ns = None
        self._pause_s = FIRST_PAUSE_S

    def _what_happened(self, error: DriverError) -> str:
        name, fault = self._driver.spec.name, self._driver.fault
        if isinstance(error, FaultLatched):
            if fault is None:
                return f"{name} is stopped ({error})"
            return (
                f"{name} is stopped by fault {fault.name!r} ({fault.reason}) until an operator "
                f"clears it (iher-robot clear-fault {shlex.quote(fault.name)})"
            )
        if isinstance(error, LeaseRefused):
            return f"{name} is leased by another client now ({error})"
        return f"{name} is lost ({error})"
