"""Figures of an experiment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator, PercentFormatter

from iher_robot.evaluation.plot import COLORS, FAINT, FRAME, GRID, INK
from iher_robot.experiments.report.findings import RATES, Method
from iher_robot.storage.files.atomic import write_atomically

_MARKERS = "osD^vPX*"
_DASHES = ("-", "--", ":", "-.")
_DOTS_PER_INCH = 150
_MOST_MARKERS = 30
_MOST_WITH_SEEDS = 4  # the seeds of more methods would be unreadable
_LEAST_SPAN = 8.0


def draw_success(methods: Sequence[Method], path: Path, title: str) -> None:
    """Write the plot of success against robot minutes: interquartile mean, interval, each seed.

    Args:
        methods: Methods of one task.
        path: The PNG.
        title: Title of the figure.

    Raises:
        UserError: The file cannot be written.
    """
    figure = Figure(figsize=(7.6, 4.4), dpi=_DOTS_PER_INCH, layout="constrained")
    axes = figure.add_subplot()
    crowded = sum(bool(method.runs) for method in methods) > _MOST_WITH_SEEDS
    for number, method in enumerate(methods):
        if method.runs:
            _draw_curve(axes, number, method, with_seeds=not crowded)
    axes.set_ylim(-0.02, 1.02)
    axes.yaxis.set_major_formatter(PercentFormatter(xmax=1, decimals=0))
    axes.set_ylabel("success rate", color=INK)
    _style(axes)
    axes.set_title(title, loc="left", fontsize=12, fontweight="bold", color=INK, parse_math=False)
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        figure.legend(
            handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=9
        )
    write_atomically(path, FigureCanvasAgg(figure).print_png)


def draw_minutes(methods: Sequence[Method], path: Path, title: str) -> None:
    """Write the plot of robot minutes to each success rate: each seed and the median.

    Args:
        methods: Methods of one task.
        path: The PNG.
        title: Title of the figure.

    Raises:
        UserError: The file cannot be written.
    """
    shown = [method for method in methods if method.runs]
    figure = Figure(
        figsize=(7.6, 1.7 + 0.36 * len(shown)), dpi=_DOTS_PER_INCH, layout="constrained"
    )
    panels = figure.subplots(1, len(RATES), sharey=True, sharex=True)
    for axes, rate in zip(panels, RATES, strict=True):
        for position, method in enumerate(shown):
            _draw_dots(axes, position, method, rate, COLORS[methods.index(method) % len(COLORS)])
    for axes, rate in zip(panels, RATES, strict=True):  # after drawing: the panels share an axis
        axes.set_yticks(range(len(shown)), [method.label for method in shown], parse_math=False)
        axes.set_ylim(len(shown) - 0.5, -0.5)
        _style(axes)
        axes.set_title(f"to {rate:.0%} success", loc="left", fontsize=10, color=INK)
    figure.suptitle(
        title, x=0.01, ha="left", fontsize=12, fontweight="bold", color=INK, parse_math=False
    )
    legend = [
        Line2D([], [], linestyle="", marker="o", color=FAINT, markersize=5, label="a seed"),
        Line2D(
            [], [], linestyle="", marker="|", color=FAINT, markersize=13, mew=2.2, label="median"
        ),
        Line2D(
            *([], []),
            linestyle="",
            marker=">",
            color=FAINT,
            markerfacecolor="none",
            label="not reached so far",
        ),
    ]
    figure.legend(handles=legend, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    write_atomically(path, FigureCanvasAgg(figure).print_png)


def _draw_curve(axes: Axes, number: int, method: Method, *, with_seeds: bool) -> None:
    color = COLORS[number % len(COLORS)]
    dash = _DASHES[number // len(COLORS) % len(_DASHES)]
    curve, seeds = method.curve, len(method.runs)
    if seeds > 1:
        for run in method.runs if with_seeds else ():
            axes.plot(run.minutes, run.success, color=color, linewidth=0.6, alpha=0.35, zorder=2)
        axes.fill_between(
            curve.minutes,
            curve.low,
            curve.high,
            color=color,
            alpha=0.16 if with_seeds else 0.09,
            linewidth=0,
            zorder=1,
        )
    few = len(curve.minutes) <= _MOST_MARKERS
    axes.plot(
        curve.minutes,
        curve.iqm,
        color=color,
        linestyle=dash,
        linewidth=2.0,
        marker=_MARKERS[number % len(_MARKERS)],
        markersize=4.5,
        markevery=1 if few else math.ceil(len(curve.minutes) / _MOST_MARKERS),
        zorder=3,
        label=f"{method.label} ({seeds} {'seed' if seeds == 1 else 'seeds'})",
    )


def _draw_dots(axes: Axes, position: int, method: Method, rate: float, color: str) -> None:
    found = method.minutes_to(rate)
    # Offsets: seeds that reached the rate at the same evaluation would hide each other.
    offsets = np.linspace(-0.16, 0.16, len(found.seeds)) if len(found.seeds) > 1 else [0.0]
    for seed, offset in zip(found.seeds, offsets, strict=True):
        if math.isfinite(seed.by):
            axes.plot(
                seed.by, position + offset, "o", color=color, markersize=5, alpha=0.8, zorder=3
            )
        else:
            axes.plot(
                *(seed.after, position + offset),
                ">",
                color=color,
                markersize=6,
                markerfacecolor="none",
                zorder=3,
            )
    if found.known:
        axes.plot(found.latest, position, "|", color=color, markersize=18, mew=2.4, zorder=4)


def _style(axes: Axes) -> None:
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    factor = math.sqrt(max(1.0, _LEAST_SPAN * low / high))  # a narrow axis would have no ticks
    axes.set_xlim(low / factor, high * factor)
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda minutes, _: f"{minutes:g}"))
    axes.set_xlabel("robot minutes, logarithmic", color=INK)
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(FRAME)
    axes.tick_params(colors=INK, labelsize=9, length=0)
