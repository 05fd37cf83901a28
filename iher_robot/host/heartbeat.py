"""Signs of life between the processes of a host, in shared memory."""

from __future__ import annotations

import time
from enum import IntEnum
from multiprocessing.context import SpawnContext
from typing import Any


class _Slot(IntEnum):
    BACK_BY = 0
    WATCHDOG = 1
    ENDING = 2


class Heartbeat:
    """What control loop and watchdog know of each other.

    The loop promises when it will be back, at each tick and before whatever takes longer; the
    watchdog says when it last looked. Both on this machine's monotonic clock.
    """

    def __init__(self, context: SpawnContext) -> None:
        """Make the shared memory, for processes of this context."""
        self._slots: Any = context.Array("q", len(_Slot), lock=False)

    def set_deadline(self, seconds: float) -> None:
        """The loop will be back within this time."""
        self._slots[_Slot.BACK_BY] = time.monotonic_ns() + round(seconds * 1e9)

    @property
    def overdue_s(self) -> float:
        """By how much the loop's promise is broken; negative while it is kept."""
        promised = self._slots[_Slot.BACK_BY]
        return float("-inf") if promised == 0 else (time.monotonic_ns() - promised) / 1e9

    def beat(self) -> None:
        """The watchdog looks."""
        self._slots[_Slot.WATCHDOG] = time.monotonic_ns()

    @property
    def unwatched_s(self) -> float:
        """Time since the watchdog looked."""
        return float(time.monotonic_ns() - self._slots[_Slot.WATCHDOG]) / 1e9

    def end(self) -> None:
        """Ask the processes to end."""
        self._slots[_Slot.ENDING] = 1

    @property
    def ending(self) -> bool:
        """Whether they should end."""
        return bool(self._slots[_Slot.ENDING])
