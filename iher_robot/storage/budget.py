"""Control ticks of motion that a run may spend."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction

from iher_robot.errors import UserError
from iher_robot.storage.ledger import Entry, Ledger

LONGEST_MINUTES = 1e6
"""About two years."""


class BudgetError(Exception):
    """More ticks were asked for than the budget still has."""


class Budget:
    """Control ticks of motion that a run may spend, over all its interruptions.

    Args:
        ledger: Holds what was spent, and what was granted since the run began.
        first_ticks: Ticks of motion that the run began with, see ``budget_ticks``.
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
            raise BudgetError(f"{ticks} ticks asked for, {remaining} remain in the budget")
        with self.ledger.reserve("motion", ticks, counted=counted) as entry:
            yield entry


def budget_ticks(minutes: float, control_period: float) -> int:
    """Whole control ticks in a number of robot minutes.

    Args:
        minutes: Robot minutes, taken as the decimal number that Python prints, so that 0.1 is a
            tenth.
        control_period: Seconds a tick, to the nanosecond.

    Returns:
        Ticks, rounded down: 40 minutes at 0.04 s are 60000.

    Raises:
        UserError: The minutes are not finite, or do not hold a single tick.
    """
    period = Fraction(round(control_period * 10**9), 10**9)
    if not 0 < minutes <= LONGEST_MINUTES:
        raise UserError(
            f"budget is {minutes} minutes, allowed: above 0 and up to {LONGEST_MINUTES:g}"
        )
    ticks = math.floor(Fraction(repr(float(minutes))) * 60 / period)
    if ticks < 1:
        raise UserError(
            f"budget is {minutes} minutes, allowed: at least one control tick, "
            f"{float(period / 60):g} minutes"
        )
    return ticks
