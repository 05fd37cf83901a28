"""Robot minutes to a success rate, as exactly as evaluations tell, and their ratios."""

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
    """When a run came to a success rate: between two evaluations.

    Attributes:
        after: Robot minutes of the evaluation before it, zero if there was none; of the last one
            where the rate was not reached.
        by: Robot minutes of the first evaluation with the rate; infinite if there is none.
    """

    after: float
    by: float

    @classmethod
    def of(cls, run: Run, rate: float) -> Self:
        """When a run came to a rate."""
        reached = np.flatnonzero(run.success >= rate)
        if not reached.size:
            return cls(run.seen_minutes, math.inf)
        first = reached[0]
        return cls(float(run.minutes[first - 1]) if first else 0.0, float(run.minutes[first]))

    @property
    def told(self) -> float:
        """The first evaluation with the rate; how far was looked where there is none."""
        return self.by if math.isfinite(self.by) else self.after


@dataclass(frozen=True)
class MinutesTo:
    """Robot minutes to a success rate.

    A seed that has not reached it may do so at any time after its last evaluation. So the median
    is known only where that does not matter.

    Attributes:
        seeds: Of each seed.
    """

    seeds: tuple[Crossing, ...]

    @classmethod
    def of(cls, runs: Sequence[Run], rate: float) -> Self:
        """When runs came to a rate."""
        return cls(tuple(Crossing.of(run, rate) for run in runs))

    @property
    def earliest(self) -> float:
        """The least that the median of the first evaluations with the rate can be."""
        return statistics.median(seed.told for seed in self.seeds)

    @property
    def latest(self) -> float:
        """The most that it can be, infinite where half of the seeds have not reached it."""
        return statistics.median(seed.by for seed in self.seeds)

    @property
    def after(self) -> float:
        """What the median is above, whatever passed between two evaluations."""
        return statistics.median(seed.after for seed in self.seeds)

    @property
    def known(self) -> bool:
        """Whether the median of the first evaluations with the rate is known."""
        return math.isfinite(self.latest) and self.earliest == self.latest


@dataclass(frozen=True)
class Ratio:
    """How many times as many robot minutes one needs as the other.

    Attributes:
        value: Of the first evaluations with the rate, None where one of the two is not known.
        low: The least that it can be, from the evaluations before those; zero if nothing is known.
        high: The most that it can be, infinite if nothing is known.
    """

    value: float | None
    low: float
    high: float


def ratio(baseline: MinutesTo, other: MinutesTo) -> Ratio | None:
    """How many times as many minutes the baseline needs.

    Returns:
        The ratio of the medians; None where not even a bound tells which of the two is faster.
    """
    known = baseline.known and other.known
    low = baseline.after / other.latest
    high = baseline.latest / other.after if other.after > 0.0 else math.inf
    if low <= 0.0 and math.isinf(high):
        return None
    if not known and (low <= 0.0 or math.isinf(high)) and low <= 1.0 <= high:
        return None
    return Ratio(baseline.latest / other.latest if known else None, low, high)
