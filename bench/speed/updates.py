"""Gradient updates: sampling, hindsight relabelling, critic, actor and targets.

Ours against Stable-Baselines3 and sbx: DDPG with three hidden layers of 256, one critic, targets
updated at each update, four of five goals relabelled, 3,200 transitions of Push stored. Theirs also
take the achieved goal as input; ours normalise their inputs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from bench.speed import products, sbx, stable_baselines
from bench.speed.comparison import Comparison, Contender, Kind, Measure, Target
from bench.speed.learners import ACTION, GOAL, OBSERVATION, OURS, fill, learner_of_push
from bench.speed.precision import Precision
from bench.speed.products import Products
from bench.speed.settings import Settings
from bench.speed.timing import seconds_of
from iher_robot.learning.transitions import BLOCK

HIDDEN = (256, 256, 256)
TARGETS = {256: 3.0, 2048: 2.0}
"""By batch: required factor over Stable-Baselines3."""
QUICK_TARGETS = {32: 3.0}
STORED = (1_000_000, 100_000, 10_000)
QUICK_STORED = (4_800, 3_200)
FLAT = 0.9


@contextmanager
def comparisons(settings: Settings) -> Iterator[list[Comparison]]:
    """Updates against the rivals, and with a growing replay."""
    targets = settings.sized(TARGETS, QUICK_TARGETS)
    theirs = stable_baselines.agent(settings, HIDDEN)
    with sbx.agent(settings, HIDDEN) as jax:
        found = [
            against_rivals(settings, precision, batch, ratio, theirs, jax)
            for batch, ratio in targets.items()
            for precision in settings.precisions
        ]
        yield [*found, with_more_stored(settings, settings.precisions[0])]


def against_rivals(
    settings: Settings,
    precision: Precision,
    batch: int,
    ratio: float,
    theirs: stable_baselines.Agent,
    jax: sbx.Agent | sbx.Absent,
) -> Comparison:
    count, rival = updates_a_round(settings, batch), stable_baselines.NAME
    return Comparison(
        topic="updates",
        work=f"gradient updates, batch {batch:,}",
        unit="updates/s",
        kind=Kind.RATE,
        contenders=(
            Contender(OURS, learner_measure(settings, precision, batch)),
            theirs.contender(precision, batch, count),
            jax.contender(precision, batch, count),
        ),
        precision=precision,
        products=work(batch),
        target=Target(f"{ratio:g} x {rival}", rival=rival, ratio=ratio),
    )


def work(batch: int) -> Products:
    operations = products.update(batch, OBSERVATION + GOAL, ACTION, HIDDEN)
    return Products(operations, rows=batch, width=HIDDEN[0])


def updates_a_round(settings: Settings, batch: int) -> int:
    """Similar duration at each batch size; whole blocks, as the learner samples them."""
    return settings.sized(5 if batch == 256 else 1, 1) * BLOCK


def learner_measure(
    settings: Settings, precision: Precision, batch: int, stored: int | None = None
) -> Measure:
    count = updates_a_round(settings, batch)
    learner = learner_of_push(settings, precision, overrides(batch, count, stored))
    if stored is not None:
        fill(learner, stored)

    def measure(_: int) -> float:
        with precision.on_this_process():
            # An epoch without models and imagination consists of its updates.
            return count / seconds_of(learner.learn, settings.device)

    measure(0)  # warm-up: compilation and allocation
    return measure


def overrides(batch: int, count: int, stored: int | None) -> Sequence[str]:
    return [
        "learner.schedule.workers=1",
        f"learner.schedule.batches={BLOCK}",
        f"learner.schedule.cycles={count // BLOCK}",
        f"learner.replay.capacity={stored or 100_000}",
        f"learner.ddpg.batch_size={batch}",
        "learner.ddpg.source_input=false",
        "learner.ddpg.target_update=update",
        "learner.imagination.enabled=false",
        "learner.intrinsic.enabled=false",
    ]


def with_more_stored(settings: Settings, precision: Precision) -> Comparison:
    """Cost of an update as the replay grows."""
    batch = settings.sized(256, 32)
    contenders = tuple(
        Contender(f"{OURS}, {stored:,} stored", learner_measure(settings, precision, batch, stored))
        for stored in settings.sized(STORED, QUICK_STORED)
    )
    least = contenders[-1].name
    return Comparison(
        topic="updates",
        work="gradient updates from a fuller replay",
        unit="updates/s",
        kind=Kind.RATE,
        contenders=contenders,
        precision=precision,
        products=work(batch),
        target=Target(f"{FLAT:g} x {least}", rival=least, ratio=FLAT),
    )
