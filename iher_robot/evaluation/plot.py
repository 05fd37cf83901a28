"""Success against robot minutes, as a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from iher_robot.storage.files.atomic import write_atomically

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Rows = Sequence[Mapping[str, Any]]
Point = tuple[float, float]

# Okabe and Ito's colours, which people with any colour vision tell apart.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
INK, FAINT, GRID, FRAME = "#222222", "#8A8A8A", "#E6E6E6", "#BBBBBB"
_INCHES = (7.2, 4.2)
_DOTS_PER_INCH = 150
_MOST_MARKERS = 40


def plot_success(
    rows_by_label: Mapping[str, Rows],
    path: Path,
    title: str,
    subtitle: str = "",
    *,
    budget_minutes: float | None = None,
    log_x: bool = False,
) -> None:
    """Write a PNG of the success rate against robot minutes.

    Args:
        rows_by_label: Metrics of each run; rows with ``robot_minutes`` and ``success`` are shown.
        path: The picture.
        title: What was learned.
        subtitle: How.
        budget_minutes: Marked by a line, if given.
        log_x: Logarithmic minutes, for runs of very different lengths.

    Raises:
        UserError: The picture cannot be written.
    """
    # Half a second, which those that plot nothing need not wait.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=_INCHES, dpi=_DOTS_PER_INCH, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    curves = {label: success_points(rows, log_x=log_x) for label, rows in rows_by_label.items()}
    _draw_curves(axes, curves)
    if budget_minutes is not None:
        _draw_budget(axes, budget_minutes)
    _dress(axes, curves, budget_minutes, log_x=log_x)
    # parse_math: a dollar sign in the name of a preset is no formula.
    axes.set_title(
        title, loc="left", fontsize=13, fontweight="bold", color=INK, pad=30, parse_math=False
    )
    _write_above(axes, (0, 1), "axes fraction", subtitle, fontsize=9, ha="left", rise=17)
    write_atomically(path, canvas.print_png)


def success_points(rows: Rows, *, log_x: bool = False) -> list[Point]:
    """Evaluations among metrics, in order.

    Args:
        rows: Metrics of a run.
        log_x: Leave out those at zero minutes.

    Returns:
        Robot minutes and success rate of each.
    """
    points = [
        (float(row["robot_minutes"]), float(row["success"]))
        for row in rows
        if row.get("robot_minutes") is not None and row.get("success") is not None
    ]
    return sorted(point for point in points if not log_x or point[0] > 0)


def _draw_curves(axes: Axes, curves: Mapping[str, Sequence[Point]]) -> None:
    longest = max((len(points) for points in curves.values()), default=0)
    for number, (label, points) in enumerate(curves.items()):
        minutes, rates = zip(*points, strict=True) if points else ((), ())
        axes.plot(
            minutes,
            rates,
            color=COLORS[number % len(COLORS)],
            # The colours come round again after seven curves.
            linestyle=("-", "--", ":")[number // len(COLORS) % 3],
            linewidth=1.8,
            marker="o" if longest <= _MOST_MARKERS else "",
            markersize=4,
            clip_on=False,
            zorder=3,
            label=label,
        )
    if not any(curves.values()):
        axes.text(0.5, 0.5, "no evaluation yet", transform=axes.transAxes, ha="center", color=FAINT)


def _draw_budget(axes: Axes, budget_minutes: float) -> None:
    axes.axvline(budget_minutes, color=FAINT, linewidth=1, linestyle=(0, (4, 3)), zorder=1)
    label = f"budget {budget_minutes:g} min"
    place = ("data", "axes fraction")
    _write_above(axes, (budget_minutes, 1), place, label, fontsize=8, ha="right", rise=4)


def _write_above(
    axes: Axes,
    xy: tuple[float, float],
    xycoords: str | tuple[str, str],
    text: str,
    *,
    fontsize: int,
    ha: Literal["left", "right"],
    rise: int,
) -> None:
    axes.annotate(
        text,
        xy=xy,
        xycoords=xycoords,
        xytext=(0, rise),
        textcoords="offset points",
        ha=ha,
        fontsize=fontsize,
        color=FAINT,
        parse_math=False,
    )


def _dress(
    axes: Axes,
    curves: Mapping[str, Sequence[Point]],
    budget_minutes: float | None,
    *,
    log_x: bool,
) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator, PercentFormatter

    axes.set_ylim(0, 1)
    axes.yaxis.set_major_formatter(PercentFormatter(xmax=1, decimals=0))
    axes.set_xlabel("robot minutes", color=INK)
    axes.set_ylabel("success rate", color=INK)
    if log_x and any(curves.values()):
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_minor_locator(NullLocator())
    else:
        ends = [points[-1][0] for points in curves.values() if points]
        axes.set_xlim(0, max([*ends, budget_minutes or 0.0]) * 1.02 or 1.0)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda minutes, _: f"{minutes:g}"))
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(FRAME)
    axes.tick_params(colors=INK, labelsize=9, length=0)
    axes.tick_params(axis="x", pad=8)  # or the two labels of the origin touch
    if len(curves) > 1:
        axes.legend(frameon=False, fontsize=9, loc="upper left", bbox_to_anchor=(1.0, 1.0))
