"""Measures in rounds: in each one, each contender once, forwards and backwards in turn."""

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
    """What a comparison came to.

    Attributes:
        comparison: Which.
        figures: Of each contender, by its place, one a round; empty where it is absent.
        products: Operations a second of the matrix products, one a round.
    """

    comparison: Comparison
    figures: list[list[float]] = field(default_factory=list)
    products: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.figures = [[] for _ in self.comparison.contenders]


def run_rounds(
    comparisons: Sequence[Comparison], settings: Settings, told: Callable[[int], None]
) -> list[Found]:
    """Measure.

    Args:
        comparisons: Which.
        settings: How often, and where.
        told: Told each round as it ends, from 1.
    """
    found = [Found(comparison) for comparison in comparisons]
    for number in range(settings.rounds):
        for each in in_turn(found, number):
            limit = each.comparison.at_most_rounds
            if limit is None or number < limit:
                one_round(each, settings, number)
        told(number + 1)
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
    """Forwards in the first round, backwards in the next."""
    return items if number % 2 == 0 else items[::-1]
