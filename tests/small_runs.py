"""Training runs that take seconds, and their results."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from iher_robot.storage.accounts import read_accounts
from iher_robot.storage.episode_reader import EpisodeReader
from iher_robot.training import setup as setup_module
from iher_robot.training import train as train_module
from iher_robot.training.result import TrainResult
from iher_robot.training.train import train

TINY_LEARNER = (
    "learner.schedule.cycles=2",
    "learner.schedule.batches=5",
    "learner.schedule.dynamics_steps=5",
    "learner.schedule.policy_copy_cycles=2",
    "learner.ddpg.batch_size=64",
    "learner.dynamics.hidden=[32, 32]",
)
TINY = (
    *TINY_LEARNER,
    "evaluation.episodes=2",
    "evaluation.final_episodes=2",
)
EPOCH_MINUTES = 0.0667  # a little more than the 100 ticks of an epoch of two episodes
TIMINGS = {"wall_seconds", "updates_per_second", "sha256"}  # and values derived from them


def run(out: Path, minutes: float, *overrides: str, **options: Any) -> TrainResult:
    options = {"task": "reach", "preset": "paper"} | options
    return train(
        budget_minutes=minutes,
        overrides=(*TINY, *overrides),
        out=out,
        until_success=options.pop("until_success", None),
        device="cpu",
        display=False,
        **options,
    )


def metrics(out: Path) -> list[dict[str, float]]:
    rows = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    return [{k: v for k, v in row.items() if k not in TIMINGS} for row in rows]


def motion_ticks(out: Path) -> int:
    return read_accounts(out / "ledger.sqlite").spent["motion"]


def stored_ticks(out: Path) -> int:
    with EpisodeReader(out / "episodes") as reader:
        return sum(len(stored.episode) for stored in reader)


class Interruption(KeyboardInterrupt):
    pass


@contextmanager
def interruption(owner: type, name: str, call: int) -> Iterator[None]:
    """Raise an interrupt at the given call of a method; it must propagate."""
    original: Callable[..., Any] = getattr(owner, name)
    calls = 0

    def counted(self: Any, *args: Any, **options: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == call:
            raise Interruption
        return original(self, *args, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(owner, name, counted)
        with pytest.raises(Interruption):
            yield


def leave_out_the_simulator(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give runs no simulator for evaluation, as with a physical robot."""
    original = setup_module.open_training_setup

    @contextmanager
    def without_simulator(config: Any) -> Iterator[Any]:
        with original(config) as setup:
            yield dataclasses.replace(setup, simulator=None)

    monkeypatch.setattr(train_module, "open_training_setup", without_simulator)
