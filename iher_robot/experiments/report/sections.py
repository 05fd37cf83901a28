"""Rows of a report's tables: the section of each task, and the table of all tasks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from iher_robot.experiments.report import formatting
from iher_robot.experiments.report.findings import (
    RATES,
    Method,
    Overall,
    baseline_of,
    ratio_to_baseline,
)
from iher_robot.experiments.report.statistics import LEAST_TRIMMED


def task_section(task: str, methods: Sequence[Method]) -> dict[str, Any]:
    """Values of a task's section, without its figures.

    Args:
        task: Name of the task.
        methods: Its methods.
    """
    return {
        "title": task.replace("_", " ").capitalize(),
        "rows": [_method(method, methods) for method in methods if method.runs],
        "missing": [formatting.plain(cell) for method in methods for cell in method.missing],
        "baselines": _baselines(methods),
    }


def overall_row(overall: Overall) -> list[str]:
    """Row of a method in the table of all tasks."""
    return [
        formatting.plain(overall.label),
        str(overall.seeds),
        formatting.span(overall.robot_minutes),
        formatting.estimate(overall.iqm),
        formatting.estimate(overall.mean),
    ]


def _baselines(methods: Sequence[Method]) -> list[str]:
    """Labels of the baselines of the ratios."""
    labels = [
        formatting.plain(baseline.label)
        for method in methods
        if (baseline := baseline_of(method, methods)) is not None and baseline is not method
    ]
    return list(dict.fromkeys(labels))


def _method(method: Method, others: Sequence[Method]) -> list[str]:
    count = len(method.runs)
    of_all = f"{method.finished} of {count + len(method.missing)} finished"
    return [
        formatting.plain(method.label),
        str(count) if method.complete else of_all,
        *(formatting.minutes_to(method.minutes_to(rate)) for rate in RATES),
        formatting.ratio(ratio_to_baseline(method, others, RATES[-1])),
        formatting.estimate(method.last("iqm")),
        formatting.estimate(method.last("mean")) if count >= LEAST_TRIMMED else "",
        formatting.percents(method.last_rates) if count > 1 else "",
        _final(method),
        formatting.span(method.robot_minutes) + _stop(method),
        _evaluations(method),
        formatting.duration(method.wall_seconds),
    ]


def _stop(method: Method) -> str:
    rates = dict.fromkeys(run.until_success for run in method.runs)
    shown = [formatting.percent(rate) for rate in rates if rate is not None]
    return f" (stops at {' or '.join(shown)} %)" if shown else ""


def _evaluations(method: Method) -> str:
    """Interval between evaluations, and their episodes."""
    spacings = [run.spacing_minutes for run in method.runs]
    episodes = dict.fromkeys(str(run.episodes) for run in method.runs)
    return (
        f"{formatting.span((min(spacings), max(spacings)))} min, {' or '.join(episodes)} episodes"
    )


def _final(method: Method) -> str:
    """Successes of the final policies, in the order of the seeds."""
    finals = [run.final for run in method.runs]
    if not any(finals):
        return formatting.UNKNOWN
    return ", ".join(
        formatting.UNKNOWN if final is None else "{} of {}".format(*final) for final in finals
    )
