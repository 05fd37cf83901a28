"""Memory of Push's learner with full replays; bench/memory.py measures more and longer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import torch

from bench.memory import in_own_process, memory
from bench.speed.comparison import Comparison, Contender, Kind
from bench.speed.learners import fill, learner_with_models
from bench.speed.settings import Settings


@contextmanager
def comparisons(settings: Settings) -> Iterator[list[Comparison]]:
    """Peak resident memory until a million imagined transitions are refilled."""
    count = settings.sized(1_000_000, 4_000)

    def measure(_: int) -> float:
        return in_own_process(partial(peak_when_full, settings, count))["peak"]

    yield [
        Comparison(
            topic="memory",
            work=f"{count:,} real transitions, {count:,} imagined anew",
            unit="MB",
            kind=Kind.AMOUNT,
            contenders=(Contender("iher_robot", measure),),
            at_most_rounds=1,
        )
    ]


def peak_when_full(settings: Settings, count: int) -> dict[str, float]:
    """Peak memory; run in a separate process."""
    torch.set_num_threads(settings.threads)
    learner = learner_with_models(settings, settings.precisions[0])
    fill(learner, count)
    learner.imagined.level = count  # refilled in the next epoch
    learner.learn()
    return memory()
