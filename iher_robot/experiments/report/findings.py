"""Findings of an experiment: methods by task, ratios to the baseline, overall rates."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from iher_robot.experiments.folder import NOT_BEGUN
from iher_robot.experiments.report.minutes_to_success import MinutesTo, Ratio, ratio
from iher_robot.experiments.report.statistics import (
    Curve,
    Estimate,
    Run,
    estimate,
    runs_of,
    success_curve,
)

RATES = (0.5, 0.9)
_BASELINE = "her"
_METHOD_KEY = ("algo", "preset", "variant", "budget", "robot")


@dataclass(frozen=True)
class Method:
    """The runs of a task that differ in their seeds alone.

    Attributes:
        task: Name of the task.
        key: Values of the columns that distinguish methods.
        label: Name in the report: the parts that vary in the experiment.
        runs: Its evaluated runs, by seed.
        missing: Cells without an evaluation.
    """

    task: str
    key: tuple[Any, ...]
    label: str
    runs: tuple[Run, ...]
    missing: tuple[str, ...]

    @property
    def algo(self) -> str:
        """Name of its algorithm."""
        return str(self.key[0])

    @cached_property
    def curve(self) -> Curve:
        """Success over robot minutes."""
        return success_curve(self.runs)

    def minutes_to(self, rate: float) -> MinutesTo:
        """Robot minutes to a success rate."""
        return MinutesTo.of(self.runs, rate)

    @property
    def last_rates(self) -> tuple[float, ...]:
        """Rate of the last evaluation of each seed."""
        return tuple(float(run.success[-1]) for run in self.runs)

    def last(self, kind: str) -> Estimate:
        """Rate of the last evaluation, over seeds."""
        return estimate(self.last_rates, kind=kind)

    @property
    def finished(self) -> int:
        """Number of finished runs."""
        return sum(run.ended for run in self.runs)

    @property
    def complete(self) -> bool:
        """Whether all of its runs have finished."""
        return bool(self.runs) and self.finished == len(self.runs) and not self.missing

    @property
    def robot_minutes(self) -> tuple[float, float]:
        """Smallest and largest robot minutes of the last evaluation."""
        seen = [run.seen_minutes for run in self.runs]
        return min(seen), max(seen)

    @property
    def wall_seconds(self) -> float:
        """Median of the wall-clock time."""
        return statistics.median(run.wall_seconds for run in self.runs)


@dataclass(frozen=True)
class Overall:
    """The rate of the last evaluation over all tasks.

    Attributes:
        label: The method.
        seeds: Number of seeds of each task.
        robot_minutes: Smallest and largest robot minutes of the last evaluation.
        iqm: Interquartile mean over seeds and tasks.
        mean: Mean over seeds and tasks.
    """

    label: str
    seeds: int
    robot_minutes: tuple[float, float]
    iqm: Estimate
    mean: Estimate


def find_methods(evaluations: Any, runs: Any) -> dict[str, list[Method]]:
    """Group the runs of an experiment by task and method, in the order of the tables.

    Args:
        evaluations: Table of evaluations.
        runs: Table of runs.
    """
    begun = runs[runs["state"] != NOT_BEGUN]
    by_cell = runs_of(evaluations, begun)
    rows = [_with_budget(row) for row in runs.to_dict("records")]
    varied = [key for key in _METHOD_KEY if len({row[key] for row in rows}) > 1]
    groups: dict[str, dict[tuple[Any, ...], list[str]]] = {}
    for row in rows:
        key = tuple(row[name] for name in _METHOD_KEY)
        groups.setdefault(row["task"], {}).setdefault(key, []).append(row["cell"])
    found = {}
    for task, methods in groups.items():
        found[task] = [
            Method(
                task,
                key,
                _label(key, varied),
                tuple(
                    sorted(
                        (by_cell[c] for c in cells if c in by_cell and by_cell[c].minutes.size),
                        key=lambda run: run.seed,
                    )
                ),
                tuple(c for c in cells if c not in by_cell or not by_cell[c].minutes.size),
            )
            for key, cells in methods.items()
        ]
    return found


def baseline_of(method: Method, others: Iterable[Method]) -> Method | None:
    """Baseline of a method: of those with algorithm ``her`` the one with the most similar key."""
    candidates = [other for other in others if other.algo == _BASELINE and other.runs]
    return max(
        candidates,
        key=lambda other: sum(a == b for a, b in zip(other.key, method.key, strict=True)),
        default=None,
    )


def ratio_to_baseline(method: Method, others: Iterable[Method], rate: float) -> Ratio | None:
    """Robot minutes of the baseline over those of a method, see `minutes_to_success.ratio`."""
    baseline = baseline_of(method, others)
    if baseline is None or baseline is method or not method.runs:
        return None
    return ratio(baseline.minutes_to(rate), method.minutes_to(rate))


def over_tasks(methods: Mapping[str, Sequence[Method]]) -> list[Overall]:
    """Aggregate the complete methods that have the same number of seeds in every task."""
    if len(methods) < 2:
        return []
    by_label = {
        label: [m for group in methods.values() for m in group if m.label == label]
        for label in dict.fromkeys(m.label for group in methods.values() for m in group)
    }
    found = []
    for label, group in by_label.items():
        counts = {len(method.runs) for method in group}
        complete = all(method.complete for method in group)
        if len(group) == len(methods) and len(counts) == 1 and complete:
            rates = [method.last_rates for method in group]
            ends = [minutes for method in group for minutes in method.robot_minutes]
            iqm, mean = estimate(*rates, kind="iqm"), estimate(*rates, kind="mean")
            found.append(Overall(label, counts.pop(), (min(ends), max(ends)), iqm, mean))
    return found


def _with_budget(row: Mapping[Any, Any]) -> dict[str, Any]:
    budget = row["budget"]
    if not (isinstance(budget, float) and math.isfinite(budget)):
        budget = None
    return {str(name): value for name, value in row.items()} | {"budget": budget}


def _label(key: tuple[Any, ...], varied: Sequence[str]) -> str:
    shown = varied or ("algo", "preset")
    parts = []
    for name, value in zip(_METHOD_KEY, key, strict=True):
        if name in shown and value not in (None, ""):
            parts.append(f"{value:g} min" if name == "budget" else str(value))
    return ", ".join(parts) or ", ".join(str(value) for value in key[:2])
