"""Robot time that passes while a run has the robot and does not move it."""

from __future__ import annotations

from contextlib import ExitStack

from drivers import RobotDriver
from iher_robot.storage.ledger import Entry, Ledger

_AHEAD_S = 10.0
"""How much more waiting is noted than has passed."""
_RESERVED_S = 60.0
"""How much is written down at once."""


class IdleMeter:
    """Charges the account ``idle`` with the time between two episodes of a robot in real time.

    Args:
        driver: The robot. A simulation that is as fast as it can has no idle time.
        ledger: Accounts of the run.
    """

    def __init__(self, driver: RobotDriver, ledger: Ledger) -> None:
        self._driver = driver
        self._ledger = ledger
        self._period_ns = driver.spec.control_period_ns
        self._stack = ExitStack()
        self._entry: Entry | None = None
        self._since_ns = 0

    def begin(self) -> None:
        """The robot waits from now on."""
        if self._driver.paces_itself and self._entry is None:
            self._since_ns = self._driver.now_ns
            reserved = max(1, round(_RESERVED_S * 1e9 / self._period_ns))
            self._entry = self._stack.enter_context(
                self._ledger.reserve("idle", reserved, counted=True)
            )
            self.note()

    def note(self) -> None:
        """Note how long it has waited, and some time ahead; a crash leaves that counted."""
        if self._entry is None:
            return
        noted = self._ticks() + round(_AHEAD_S * 1e9 / self._period_ns)
        if noted > self._entry.reserved_ticks:
            self.end()
            self.begin()
        else:
            self._entry.begin(noted)

    def end(self) -> None:
        """It waits no longer."""
        entry, self._entry = self._entry, None
        if entry is not None:
            entry.settle(self._ticks())
            self._stack.close()

    def _ticks(self) -> int:
        return -(-(self._driver.now_ns - self._since_ns) // self._period_ns)
