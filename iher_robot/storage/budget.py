"""Budget of motion ticks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from iher_robot.storage.ledger import Entry, Ledger
from iher_robot.storage.robot_time import RobotTime


class BudgetError(Exception):
    """The budget has fewer ticks than requested."""


class Budget:
    """Control ticks of motion that a run may spend, resumptions included.

    Args:
        ledger: Ticks spent, and ticks granted since the run began.
        first_ticks: Budget that the run began with, see ``budget_ticks``.
    """

    def __init__(self, ledger: Ledger, first_ticks: int) -> None:
        self.ledger = ledger
        self._first_ticks = first_ticks

    @property
    def budget_ticks(self) -> int:
        """Ticks that the account ``motion`` may reach."""
        return self._first_ticks + self.ledger.granted_ticks

    @property
    def spent_ticks(self) -> int:
        """Ticks of motion so far, reservations included."""
        return self.ledger.spent_ticks("motion")

    @property
    def remaining_ticks(self) -> int:
        """Ticks that may still be reserved, never negative."""
        return max(0, self.budget_ticks - self.spent_ticks)

    @contextmanager
    def reserve(self, ticks: int, *, counted: bool = False) -> Iterator[Entry]:
        """Reserve ticks of motion, see ``Ledger.reserve``.

        Raises:
            BudgetError: Fewer remain; nothing is reserved.
        """
        remaining = self.remaining_ticks
        if ticks > remaining:
            raise BudgetError(f"{ticks} ticks requested, {remaining} remain in the budget")
        with self.ledger.reserve("motion", ticks, counted=counted) as entry:
            yield entry


def budget_ticks(minutes: float, control_period: float) -> int:
    """Whole control ticks of a budget, see `RobotTime.from_minutes`."""
    return RobotTime.from_minutes(minutes, control_period).ticks
