"""Heartbeats between the processes of a host, in shared memory."""

from __future__ import annotations

import time
from enum import IntEnum
from multiprocessing.context import SpawnContext
from typing import Any


class _Slot(IntEnum):
    DEADLINE = 0
    WATCHDOG = 1
    ENDING = 2


class Heartbeat:
    """Deadline of the control loop and last check of the watchdog, each written by one of them.

    The loop sets a deadline at each tick and before anything that takes longer. Times are on this
    machine's monotonic clock.
    """

    def __init__(self, context: SpawnContext) -> None:
        """Allocate the shared memory, for processes of this context."""
        self._slots: Any = context.Array("q", len(_Slot), lock=False)

    def set_deadline(self, seconds: float) -> None:
        """Set the time within which the control loop will set its next deadline."""
        self._slots[_Slot.DEADLINE] = time.monotonic_ns() + round(seconds * 1e9)

    @property
    def overdue_s(self) -> float:
        """Time since the control loop's deadline passed; negative before it."""
        deadline_ns = self._slots[_Slot.DEADLINE]
        return float("-inf") if deadline_ns == 0 else (time.monotonic_ns() - deadline_ns) / 1e9

    def beat(self) -> None:
        """Record a check by the watchdog."""
        self._slots[_Slot.WATCHDOG] = time.monotonic_ns()

    @property
    def unwatched_s(self) -> float:
        """Time since the watchdog's last check."""
        return float(time.monotonic_ns() - self._slots[_Slot.WATCHDOG]) / 1e9

    def end(self) -> None:
        """Ask the processes to end."""
        self._slots[_Slot.ENDING] = 1

    @property
    def ending(self) -> bool:
        """Whether the processes were asked to end."""
        return bool(self._slots[_Slot.ENDING])
