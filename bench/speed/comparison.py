"""What is compared: one piece of work, those who do it, and how well they should."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from bench.speed.precision import Precision
from bench.speed.products import Products


class Kind(Enum):
    """What a figure is, and so what a ratio of two of them means."""

    RATE = "a second"
    SECONDS = "seconds"
    AMOUNT = "amount"


Measure = Callable[[int], float]
"""Takes the number of the round, from 0, and returns the round's figure."""


@dataclass(frozen=True)
class Contender:
    """One who does the work.

    Attributes:
        name: Whose code it is.
        measure: Does the work once; None where it is absent.
        note: What sets it apart, or why it is absent.
    """

    name: str
    measure: Measure | None
    note: str = ""


@dataclass(frozen=True)
class Target:
    """What our figure should reach: at least one of the bounds that are given.

    Attributes:
        text: How it reads.
        rival: How the names of those begin whose best figure ours is compared with.
        ratio: At least so many times better than the rival.
        seconds: At most so many.
        times_products: At most so many times what the matrix products alone need.
    """

    text: str
    rival: str = ""
    ratio: float | None = None
    seconds: float | None = None
    times_products: float | None = None


@dataclass(frozen=True)
class Comparison:
    """One piece of work, and who does it; the first contender is ours.

    Attributes:
        topic: Which part of a training run it is of.
        work: What is done, with its sizes.
        unit: Unit of the figures.
        kind: What the figures are.
        contenders: At least one.
        precision: What all of them compute in, where it matters.
        products: The matrix products that one unit of the work cannot do without.
        target: What ours should reach.
        at_most_rounds: Fewer rounds than the others, where one takes minutes.
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
