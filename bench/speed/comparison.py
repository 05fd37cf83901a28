"""Comparison of contenders at one workload, with a target."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from bench.speed.precision import Precision
from bench.speed.products import Products


class Kind(Enum):
    """Kind of a figure, which defines the ratio of two."""

    RATE = "a second"
    SECONDS = "seconds"
    AMOUNT = "amount"


Measure = Callable[[int], float]
"""Takes the number of the round, from 0, and returns the round's figure."""


@dataclass(frozen=True)
class Contender:
    """An implementation of the workload.

    Attributes:
        name: Name of the library.
        measure: Runs the workload once; None where it is absent.
        note: Differences from the others, or why it is absent.
    """

    name: str
    measure: Measure | None
    note: str = ""


@dataclass(frozen=True)
class Target:
    """Target of our figure; all bounds that are given must hold.

    Attributes:
        text: Text in the table.
        rival: Prefix of the rivals' names; the best of them counts.
        ratio: Minimal factor by which ours is better than the rival.
        seconds: Maximal time, s.
        times_products: Maximal multiple of the time of the matrix products alone.
    """

    text: str
    rival: str = ""
    ratio: float | None = None
    seconds: float | None = None
    times_products: float | None = None


@dataclass(frozen=True)
class Comparison:
    """A workload and its contenders; the first one is ours.

    Attributes:
        topic: Part of a training run.
        work: Workload, with its sizes.
        unit: Unit of the figures.
        kind: Kind of the figures.
        contenders: At least one.
        precision: Precision of all contenders, where it matters.
        products: The matrix products that one unit of the workload requires.
        target: Target of ours.
        at_most_rounds: Limit of the rounds, where one takes minutes.
    """

    topic: str
    work: str
    unit: str
    kind: Kind
    contenders: tuple[Contender, ...]
    precision: Precision | None = None
    products: Products | None = None
    target: Target | None = None
    at_most_rounds: int | None = None
