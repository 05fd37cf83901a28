"""Imagined transitions with their intrinsic rewards, from five models, preset ``paper``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from bench.speed import products
from bench.speed.comparison import Comparison, Contender, Kind, Measure, Target
from bench.speed.dynamics import MEMBERS, MODEL
from bench.speed.learners import ACTION, GOAL, OBSERVATION, OURS, learner_with_models
from bench.speed.machine import has_matrix_units
from bench.speed.precision import Precision
from bench.speed.products import Products
from bench.speed.settings import Settings
from bench.speed.timing import seconds_of
from iher_robot.learning.progress import silent

POLICY = (OBSERVATION + GOAL + 1, 256, 256, 256, ACTION)  # one input is the source
ROWS = 4096
"""Rows of most products of a refill."""
REFILL_S = 20.0
TIMES_PRODUCTS = 1.5


@contextmanager
def comparisons(settings: Settings) -> Iterator[list[Comparison]]:
    """Batched rollouts, and a refill of the source, in each precision."""
    found = []
    for precision in settings.precisions:
        found += [rollouts_at_once(settings, precision), whole_refill(settings, precision)]
    yield found


def rollouts_at_once(settings: Settings, precision: Precision) -> Comparison:
    rollouts = settings.sized(1_000, 4)
    return Comparison(
        topic="imagination",
        work=f"imagined transitions, {rollouts:,} rollouts at once",
        unit="transitions/s",
        kind=Kind.RATE,
        contenders=(Contender(OURS, adding(settings, precision, rollouts)),),
        precision=precision,
        products=transitions(1),
    )


def whole_refill(settings: Settings, precision: Precision) -> Comparison:
    count = settings.sized(1_000_000, 500)
    target = Target(f"{TIMES_PRODUCTS:g} x the products", times_products=TIMES_PRODUCTS)
    if precision.name != "fp32" and has_matrix_units(settings.device):
        target = Target(f"{REFILL_S:g} s", seconds=REFILL_S)
    return Comparison(
        topic="imagination",
        work=f"{count:,} transitions imagined anew",
        unit="s",
        kind=Kind.SECONDS,
        contenders=(Contender(OURS, refilling(settings, precision, count)),),
        precision=precision,
        products=transitions(count),
        target=target,
        at_most_rounds=3,
    )


def transitions(count: int) -> Products:
    operations = products.imagined_transition(POLICY, MEMBERS, MODEL)
    return Products(count * operations, rows=ROWS, width=MODEL[1])


def adding(settings: Settings, precision: Precision, rollouts: int) -> Measure:
    learner = learner_with_models(settings, precision)

    def imagine() -> None:
        learner.imagined.add_rollouts(learner.ensemble, learner.policy, rollouts, epoch=1)

    def measure(_: int) -> float:
        with precision.on_this_process():
            seconds = seconds_of(imagine, settings.device)
        return rollouts * learner.shapes.episode_ticks / seconds

    measure(0)  # warm-up: compilation and allocation
    return measure


def refilling(settings: Settings, precision: Precision, count: int) -> Measure:
    learner = learner_with_models(settings, precision)

    def refill() -> None:
        learner.imagined.refill(
            learner.ensemble, learner.policy, epoch=1, cycle=learner.cycle, progress=silent
        )

    def measure(_: int) -> float:
        with precision.on_this_process():
            seconds = seconds_of(refill, settings.device)
        assert learner.imagined.replay.num_transitions == count
        return seconds

    refill()  # warm-up: compilation and allocation
    learner.imagined.level = count
    return measure
