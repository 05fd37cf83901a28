"""Robot minutes to a success rate, their medians over seeds, and ratios, with bounds."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from iher_robot.experiments.report.statistics import Run


@dataclass(frozen=True)
class Crossing:
    """Interval between two evaluations in which a run reached a success rate.

    Attributes:
        after: Robot minutes of the evaluation before, zero without one; of the last evaluation
            where the rate was not reached.
        by: Robot minutes of the first evaluation at the rate; infinite without one.
    """

    after: float
    by: float

    @classmethod
    def of(cls, run: Run, rate: float) -> Self:
        """Find the interval in which a run reached a rate."""
        reached = np.flatnonzero(run.success >= rate)
        if not reached.size:
            return cls(run.seen_minutes, math.inf)
        first = reached[0]
        return cls(float(run.minutes[first - 1]) if first else 0.0, float(run.minutes[first]))

    @property
    def least(self) -> float:
        """The first evaluation at the rate; without one, the last evaluation as a lower bound."""
        return self.by if math.isfinite(self.by) else self.after


@dataclass(frozen=True)
class MinutesTo:
    """Robot minutes to a success rate over seeds.

    A seed that has not reached the rate may reach it at any time after its last evaluation. The
    median is known only where that does not change it.

    Attributes:
        seeds: Interval of each seed.
    """

    seeds: tuple[Crossing, ...]

    @classmethod
    def of(cls, runs: Sequence[Run], rate: float) -> Self:
        """Find the intervals in which runs reached a rate."""
        return cls(tuple(Crossing.of(run, rate) for run in runs))

    @property
    def earliest(self) -> float:
        """Lower bound of the median over the first evaluations at the rate."""
        return statistics.median(seed.least for seed in self.seeds)

    @property
    def latest(self) -> float:
        """Upper bound of that median, infinite where half of the seeds miss the rate."""
        return statistics.median(seed.by for seed in self.seeds)

    @property
    def after(self) -> float:
        """Lower bound of the median over the true times, which lie between two evaluations."""
        return statistics.median(seed.after for seed in self.seeds)

    @property
    def known(self) -> bool:
        """Whether the median over the first evaluations at the rate is known."""
        return math.isfinite(self.latest) and self.earliest == self.latest


@dataclass(frozen=True)
class Ratio:
    """Ratio of the robot minutes of two methods.

    Attributes:
        value: Ratio of the medians over first evaluations, None where one of them is not known.
        low: Lower bound, from the evaluations before; zero without one.
        high: Upper bound, infinite without one.
    """

    value: float | None
    low: float
    high: float


def ratio(baseline: MinutesTo, other: MinutesTo) -> Ratio | None:
    """Robot minutes of the baseline over those of the other method.

    Returns:
        The ratio of the medians; None where not even a bound shows which of the two is faster.
    """
    known = baseline.known and other.known
    low = baseline.after / other.latest
    high = baseline.latest / other.after if other.after > 0.0 else math.inf
    if low <= 0.0 and math.isinf(high):
        return None
    if not known and (low <= 0.0 or math.isinf(high)) and low <= 1.0 <= high:
        return None
    return Ratio(baseline.latest / other.latest if known else None, low, high)
