"""Training of the dynamics ensemble: a gradient step of each of five models, preset ``paper``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from bench.speed import products
from bench.speed.comparison import Comparison, Contender, Kind, Measure
from bench.speed.learners import ACTION, OBSERVATION, OURS, learner_of_push
from bench.speed.precision import Precision
from bench.speed.products import Products
from bench.speed.settings import Settings
from bench.speed.timing import seconds_of

MEMBERS, BATCH = 5, 4096
MODEL = (OBSERVATION + ACTION, 512, 512, OBSERVATION)
"""Widths of one model: observation and action in, the change of the observation out."""


@contextmanager
def comparisons(settings: Settings) -> Iterator[list[Comparison]]:
    """One for each precision."""
    batch = settings.sized(BATCH, 64)
    yield [
        Comparison(
            topic="dynamics",
            work=f"dynamics training steps, {MEMBERS} models, batch {batch:,}",
            unit="steps/s",
            kind=Kind.RATE,
            contenders=(Contender(OURS, training(settings, precision, batch)),),
            precision=precision,
            products=Products(
                products.dynamics_step(batch, MEMBERS, MODEL), rows=batch, width=MODEL[1]
            ),
        )
        for precision in settings.precisions
    ]


def training(settings: Settings, precision: Precision, batch: int) -> Measure:
    learner, steps = learner_of_push(settings, precision, ()), settings.sized(3, 1)
    learner.ensemble.fit_normalizers(learner.real.replay, learner.generator)

    def train() -> None:
        learner.ensemble.train(
            learner.real.replay, steps, batch_size=batch, generator=learner.generator
        )

    def measure(_: int) -> float:
        with precision.on_this_process():
            return steps / seconds_of(train, settings.device)

    measure(0)  # warm-up: compilation and allocation
    return measure
