"""Budget of a run: robot time of motion that it may spend, over all its interruptions."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from iher_robot.storage.ledger import Entry, Ledger
from iher_robot.storage.robot_time import RobotTime


class BudgetError(Exception):
    """More ticks were requested than the budget still has."""


class Budget:
    """Robot time of motion that a run may spend, over all its interruptions.

    Args:
        ledger: Ledger of the run: what was spent, and what was granted since it began.
        initial: Budget that the run began with.
    """

    def __init__(self, ledger: Ledger, initial: RobotTime) -> None:
        self.ledger = ledger
        self._initial = initial

    @property
    def total(self) -> RobotTime:
        """Initial budget and grants."""
        return self._initial.with_ticks(self._initial.ticks + self.ledger.granted_ticks)

    @property
    def spent(self) -> RobotTime:
        """Motion so far, reservations included."""
        return self._initial.with_ticks(self.ledger.spent_ticks("motion"))

    @property
    def remaining(self) -> RobotTime:
        """Motion that may still be reserved, never less than 0."""
        return self.total.minus(self.spent)

    @contextmanager
    def reserve(self, ticks: int, *, counted: bool = False) -> Iterator[Entry]:
        """Reserve ticks of motion, see ``Ledger.reserve``.

        Raises:
            BudgetError: Fewer remain; nothing is reserved.
        """
        remaining = self.remaining.ticks
        if ticks > remaining:
            raise BudgetError(f"{ticks} ticks requested, {remaining} remain in the budget")
        with self.ledger.reserve("motion", ticks, counted=counted) as entry:
            yield entry
