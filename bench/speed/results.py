"""Results of a benchmark: medians, ratios, targets and a table."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from itertools import groupby
from typing import Any

from rich.table import Table

from bench.speed.comparison import Kind, Target
from bench.speed.rounds import Found

TITLES = ("work", "precision", "who", "median", "ours is", "products alone", "takes", "target")
LEFT = ("work", "precision", "who", "target")


def rows(found: Found, *, with_targets: bool) -> list[dict[str, Any]]:
    """A row for each contender, as saved; the main module documents the keys.

    Args:
        found: Figures of a comparison.
        with_targets: Whether to compare the figures with the target.
    """
    comparison, ours = found.comparison, found.figures[0]
    kept = []
    for place, (contender, figures) in enumerate(
        zip(comparison.contenders, found.figures, strict=True)
    ):
        row: dict[str, Any] = {
            "topic": comparison.topic,
            "work": comparison.work,
            "precision": comparison.precision.name if comparison.precision else None,
            "who": contender.name,
            "unit": comparison.unit,
            "median": median(figures),
            "min": min(figures, default=None),
            "max": max(figures, default=None),
            "all": figures,
            "note": contender.note,
            "ours_is": median(ratios(comparison.kind, ours, figures)) if place else None,
            "products_s": median(products_seconds(found)),
            "times_products": median(times_products(found, figures)),
        }
        if place == 0 and comparison.target is not None:
            row["target"] = comparison.target.text
            row["target_met"] = is_met(comparison.target, found) if with_targets else None
        kept.append(row)
    return kept


def median(values: Sequence[float]) -> float | None:
    return statistics.median(values) if values else None


def ratios(kind: Kind, ours: Sequence[float], theirs: Sequence[float]) -> list[float]:
    """Factor by which ours is better, per round."""
    pairs = list(zip(ours, theirs, strict=False)) if ours and theirs else []
    return [a / b if kind is Kind.RATE else b / a for a, b in pairs]


def products_seconds(found: Found) -> list[float]:
    """Seconds of the products of one unit of work, per round."""
    work = found.comparison.products
    return [work.operations / speed for speed in found.products] if work else []


def times_products(found: Found, figures: Sequence[float]) -> list[float]:
    """Time of a unit of work as a multiple of its products' time, per round."""
    alone = products_seconds(found)
    if not alone or not figures:
        return []
    durations = [1.0 / f if found.comparison.kind is Kind.RATE else f for f in figures]
    return [time / product for time, product in zip(durations, alone, strict=True)]


def is_met(target: Target, found: Found) -> bool | None:
    """Whether ours reached its target; None where it is absent."""
    ours = found.figures[0]
    if not ours:
        return None
    met = []
    if target.ratio is not None:
        met.append(worst_ratio(target, found) >= target.ratio)
    if target.seconds is not None:
        met.append(statistics.median(ours) <= target.seconds)
    if target.times_products is not None:
        met.append(statistics.median(times_products(found, ours)) <= target.times_products)
    return all(met)


def worst_ratio(target: Target, found: Found) -> float:
    """Ratio to the best of the target's rivals."""
    named = zip(found.comparison.contenders[1:], found.figures[1:], strict=True)
    rivals = [figures for contender, figures in named if contender.name.startswith(target.rival)]
    return min(
        statistics.median(ratios(found.comparison.kind, found.figures[0], figures))
        for figures in rivals
    )


def table(kept: Sequence[dict[str, Any]]) -> Table:
    """Table of all rows, a section per comparison."""
    drawn = Table(title="Medians over rounds with alternating contenders (minimum to maximum)")
    for title in TITLES:
        drawn.add_column(title, justify="left" if title in LEFT else "right")
    for (work, precision), group in groupby(kept, lambda row: (row["work"], row["precision"])):
        drawn.add_section()
        named = [work, precision or ""]
        for row in group:
            drawn.add_row(*named, *cells(row))
            named = ["", ""]
    return drawn


def cells(row: dict[str, Any]) -> list[str]:
    absent = row["median"] is None
    return [
        row["who"] + (f" ({row['note']})" if row["note"] and not absent else ""),
        row["note"] if absent else figure(row),
        times(row["ours_is"]),
        "" if absent else seconds(row["products_s"]),
        times(row["times_products"]),
        target_cell(row),
    ]


def figure(row: dict[str, Any]) -> str:
    middle = f"{shown(row['median'])} {row['unit']}"
    if len(row["all"]) == 1:
        return middle
    return f"{middle} ({shown(row['min'])} to {shown(row['max'])})"


def target_cell(row: dict[str, Any]) -> str:
    if "target" not in row:
        return ""
    verdict = {True: ": met", False: ": not met", None: ""}[row["target_met"]]
    return f"{row['target']}{verdict}"


def times(value: float | None) -> str:
    return "" if value is None else f"{value:.2f} x"


def seconds(value: float | None) -> str:
    if value is None:
        return ""
    for factor, unit in ((1.0, "s"), (1e3, "ms"), (1e6, "us")):
        if value * factor >= 1.0:
            return f"{value * factor:.3g} {unit}"
    return f"{value * 1e6:.3g} us"


def shown(value: float) -> str:
    return f"{value:,.0f}" if value >= 100.0 else f"{value:.3g}"
