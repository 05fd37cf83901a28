"""Measurement in rounds: each contender once per round, in alternating order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from bench.speed import products
from bench.speed.comparison import Comparison
from bench.speed.settings import Settings

Each = TypeVar("Each")


@dataclass
class Found:
    """Figures of a comparison.

    Attributes:
        comparison: The comparison.
        figures: Figures of each contender, in order, one per round; empty where it is absent.
        products: Operations per second of the matrix products, one per round.
    """

    comparison: Comparison
    figures: list[list[float]] = field(default_factory=list)
    products: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.figures = [[] for _ in self.comparison.contenders]


def run_rounds(
    comparisons: Sequence[Comparison], settings: Settings, on_round: Callable[[int], None]
) -> list[Found]:
    """Measure all comparisons.

    Args:
        comparisons: The comparisons.
        settings: Rounds and device.
        on_round: Called with the number of each finished round, from 1.
    """
    found = [Found(comparison) for comparison in comparisons]
    for number in range(settings.rounds):
        for each in in_turn(found, number):
            limit = each.comparison.at_most_rounds
            if limit is None or number < limit:
                one_round(each, settings, number)
        on_round(number + 1)
    return found


def one_round(found: Found, settings: Settings, number: int) -> None:
    comparison = found.comparison
    if comparison.products is not None and comparison.precision is not None:
        speed = products.rate(comparison.products, comparison.precision, settings.device)
        found.products.append(speed)
    for contender, figures in in_turn(
        list(zip(comparison.contenders, found.figures, strict=True)), number
    ):
        if contender.measure is not None:
            figures.append(contender.measure(number))


def in_turn(items: Sequence[Each], number: int) -> Sequence[Each]:
    """Forward order in even rounds, reverse order in odd ones."""
    return items if number % 2 == 0 else items[::-1]
