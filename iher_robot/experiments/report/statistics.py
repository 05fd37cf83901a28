"""Statistics of an experiment: measurements of runs, curves and rates with intervals."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap, trim_mean

Scores = NDArray[np.float64]

REPETITIONS = 2000
CONFIDENCE = 0.95
LEAST_TRIMMED = 4
"""Smallest number of scores for which the interquartile mean differs from the mean."""
_SEED = 0


@dataclass(frozen=True)
class Run:
    """Measurements of a run.

    Attributes:
        seed: Its seed.
        minutes: Robot minutes of its evaluations. ``(evaluations,)``
        success: Their success rates. ``(evaluations,)``
        episodes: Episodes per evaluation.
        ended: Whether it has finished, so that its last rate holds afterwards.
        until_success: Rate at which it stops, None where it spends its whole budget.
        wall_seconds: Wall-clock time of its training. s
        final: Successes and episodes of its final policy, None if not measured.
    """

    seed: int
    minutes: Scores
    success: Scores
    episodes: int
    ended: bool
    until_success: float | None
    wall_seconds: float
    final: tuple[int, int] | None

    @property
    def seen_minutes(self) -> float:
        """Robot minutes of the last evaluation, zero without one."""
        return float(self.minutes[-1]) if self.minutes.size else 0.0

    @property
    def spacing_minutes(self) -> float:
        """Median of the robot minutes between evaluations."""
        return float(np.median(np.diff(self.minutes, prepend=0.0)))


@dataclass(frozen=True)
class Estimate:
    """Estimate over seeds with its interval.

    Attributes:
        value: The estimate.
        low: Lower end of the 95 % bootstrap interval, NaN with one seed.
        high: Its upper end.
    """

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Curve:
    """Interquartile mean of the success rate over seeds, with intervals.

    Attributes:
        minutes: Robot minutes. ``(points,)``
        iqm: Interquartile means. ``(points,)``
        low: Lower ends of the intervals, NaN with one seed. ``(points,)``
        high: Their upper ends. ``(points,)``
    """

    minutes: Scores
    iqm: Scores
    low: Scores
    high: Scores


def success_curve(runs: Sequence[Run]) -> Curve:
    """Success over robot minutes, at every evaluation that all runs have reached.

    Between two evaluations the earlier one counts. A finished run keeps its last rate; an
    unfinished one ends the curve. The bootstrap resamples whole runs.
    """
    runs = [run for run in runs if run.minutes.size]
    if not runs:
        nothing = np.empty(0)
        return Curve(nothing, nothing, nothing, nothing)
    first = max(run.minutes[0] for run in runs)
    last = min((run.minutes[-1] for run in runs if not run.ended), default=math.inf)
    every = np.unique(np.concatenate([run.minutes for run in runs]))
    minutes = every[(every >= first) & (every <= last)]
    scores = np.stack([_rates_at(run, minutes) for run in runs])  # (seeds, points)
    return Curve(minutes, *_bootstrap([scores], "iqm"))


def estimate(*samples: Sequence[float], kind: str) -> Estimate:
    """Estimate a score over seeds, and over tasks where there are several.

    Args:
        samples: For each task, the score of each seed; seeds are resampled within each task.
        kind: ``"iqm"`` or ``"mean"``.
    """
    scores = [np.array(sample, dtype=np.float64) for sample in samples]
    value, low, high = map(float, _bootstrap(scores, kind))
    return Estimate(value, low, high)


def _rates_at(run: Run, minutes: Scores) -> Scores:
    return run.success[np.searchsorted(run.minutes, minutes, side="right") - 1]


def _iqm(*samples: Scores, axis: int) -> Scores:
    """Interquartile mean of all samples together (Agarwal et al. 2021)."""
    return np.asarray(trim_mean(np.concatenate(samples, axis=axis), 0.25, axis=axis))


def _mean(*samples: Scores, axis: int) -> Scores:
    return np.asarray(np.concatenate(samples, axis=axis).mean(axis=axis))


_STATISTICS: Mapping[str, Callable[..., Scores]] = {"iqm": _iqm, "mean": _mean}


def _bootstrap(samples: Sequence[Scores], kind: str) -> tuple[Scores, Scores, Scores]:
    """Estimate with the ends of its percentile bootstrap interval, NaN with one seed.

    Args:
        samples: Scores of each task; seeds are resampled. ``(seeds, ...)``
        kind: ``"iqm"`` or ``"mean"``.
    """
    statistic = _STATISTICS[kind]
    value = statistic(*samples, axis=0)
    if min(map(len, samples)) < 2:
        unknown = np.full_like(value, np.nan)
        return value, unknown, unknown
    interval = bootstrap(
        samples,
        statistic,
        n_resamples=REPETITIONS,
        confidence_level=CONFIDENCE,
        method="percentile",
        vectorized=True,
        axis=0,
        rng=np.random.default_rng(_SEED),
    ).confidence_interval
    return value, np.asarray(interval.low), np.asarray(interval.high)


def runs_of(evaluations: Any, runs: Any) -> Mapping[str, Run]:
    """Combine the rows of both tables, by cell.

    Args:
        evaluations: Table of evaluations.
        runs: Table of runs.
    """
    found = {}
    for row in runs.to_dict("records"):
        mine = evaluations[evaluations["cell"] == row["cell"]].sort_values("robot_minutes")
        measured = row["final_episodes"]
        known = isinstance(measured, int) and measured > 0
        until = row["until_success"]
        found[row["cell"]] = Run(
            seed=int(row["seed"]),
            minutes=mine["robot_minutes"].to_numpy(dtype=np.float64),
            success=mine["success"].to_numpy(dtype=np.float64),
            episodes=int(mine["evaluation_episodes"].iloc[-1]) if len(mine) else 0,
            ended=row["state"] == "finished",
            until_success=float(until) if isinstance(until, float) else None,
            wall_seconds=float(row["wall_seconds"]) if row["epochs"] else 0.0,
            final=(int(row["final_successes"]), int(measured)) if known else None,
        )
    return found
