"""Robot time: control ticks, and their length in seconds and minutes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction

from iher_robot.errors import UserError

LONGEST_MINUTES = 1e6
"""Largest budget, about two years."""


@dataclass(frozen=True)
class RobotTime:
    """A whole number of control ticks of one robot.

    Robot minutes are the paper's measure: control ticks times the control period.

    Example:
        >>> budget = RobotTime.from_minutes(40, control_period_s=0.04)
        >>> budget.ticks
        60000
        >>> str(budget.minus(budget.with_ticks(15_000)))
        '30.00 robot minutes'

    Attributes:
        ticks: Control ticks, at least 0.
        control_period_s: Length of a tick.

    Raises:
        ValueError: Fewer than 0 ticks, or no length.
    """

    ticks: int
    control_period_s: float

    def __post_init__(self) -> None:
        if self.ticks < 0:
            raise ValueError(f"ticks must be >= 0, not {self.ticks}")
        if not 0.0 < self.control_period_s < math.inf:
            raise ValueError(f"control_period_s must be > 0 and finite: {self.control_period_s}")

    @classmethod
    def from_minutes(cls, minutes: float, control_period_s: float) -> RobotTime:
        """Whole ticks of a budget in robot minutes, rounded down: 40 min at 0.04 s are 60000.

        Args:
            minutes: Robot minutes, taken as the decimal number that Python prints, so that 0.1 is
                a tenth.
            control_period_s: Length of a tick, taken to the nanosecond.

        Raises:
            UserError: The minutes are not finite, or shorter than a tick.
        """
        period = Fraction(_period_ns(control_period_s), 10**9)
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
        return cls(ticks, control_period_s)

    @classmethod
    def from_seconds(cls, seconds: float, control_period_s: float) -> RobotTime:
        """Ticks that cover a duration, rounded up."""
        return cls.from_ns(round(seconds * 1e9), control_period_s)

    @classmethod
    def from_ns(cls, ns: int, control_period_s: float) -> RobotTime:
        """Ticks that cover a duration in nanoseconds, rounded up: a tick that began counts."""
        return cls(-(-ns // _period_ns(control_period_s)), control_period_s)

    @property
    def minutes(self) -> float:
        """Robot minutes."""
        return self.ticks * self.control_period_s / 60.0

    @property
    def seconds(self) -> float:
        """Robot seconds."""
        return self.ticks * self.control_period_s

    def with_ticks(self, ticks: int) -> RobotTime:
        """Another time on the same robot."""
        return replace(self, ticks=ticks)

    def minus(self, other: RobotTime) -> RobotTime:
        """What is left after another time, never less than 0.

        Raises:
            ValueError: The control periods differ.
        """
        self._require_same_period(other)
        return self.with_ticks(max(0, self.ticks - other.ticks))

    def __add__(self, other: RobotTime) -> RobotTime:
        self._require_same_period(other)
        return self.with_ticks(self.ticks + other.ticks)

    def __str__(self) -> str:
        return f"{self.minutes:.2f} robot minutes"

    def _require_same_period(self, other: RobotTime) -> None:
        if self.control_period_s != other.control_period_s:
            raise ValueError(
                f"control periods differ: {self.control_period_s} s and {other.control_period_s} s"
            )


def _period_ns(control_period_s: float) -> int:
    return round(control_period_s * 1e9)
