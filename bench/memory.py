"""Benchmark of the memory of Push's learner, with full replays and over many epochs.

python bench/memory.py [--only NAME ...] [--out bench/results/memory.json]

Each measurement runs in its own process, so that peaks do not mix:

full      preset paper: a million real and a million imagined transitions
restored  the same run resumed: real transitions from episodes in memory
streamed  the same, with episodes generated on demand
soak      preset paper in short epochs: five million transitions imagined once the replays are full
short     preset default: 200 epochs of four episodes
rows      a model of the ensemble with 300 different row counts: in blocks, and all rows at once

Numbers of gradient steps are reduced, which does not affect memory; sizes of networks, batches and
rollouts are the preset's. The real episodes are 64 of random actions in simulation, repeated with
noise of 1 mm. Memory is Linux' resident set size, in 10^6 bytes.
"""

from __future__ import annotations

import argparse
import gc
import json
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractContextManager
from datetime import datetime
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch

from bench.episodes import record, variations, with_holes
from iher_robot.config.options import load_config
from iher_robot.learning.diagnostics import diagnose
from iher_robot.learning.episode import Episode
from iher_robot.learning.learner import Learner
from iher_robot.learning.networks.mlp import in_blocks
from iher_robot.learning.transitions import BLOCK
from iher_robot.storage.provenance import collect_provenance
from iher_robot.training.setup import TrainingSetup, open_training_setup

TRANSITIONS = 1_000_000
SOAK_TRANSITIONS = 5_000_000
SOAK_CAPACITY = 100_000
SHORT_EPOCHS = 200
FEW_STEPS = (
    "learner.schedule.dynamics_steps=2",
    "learner.schedule.first_epoch_dynamics_factor=1",
    "learner.schedule.batches=1",
)


def memory() -> dict[str, float]:
    """Resident memory of this process now, and its peak, MB."""
    lines = Path("/proc/self/status").read_text().splitlines()
    fields = dict(line.split(":", 1) for line in lines)
    return {
        name: round(int(fields[key].split()[0]) * 1024 / 1e6, 1)
        for name, key in (("now", "VmRSS"), ("peak", "VmHWM"))
    }


class Stages:
    """Memory after each stage of a measurement."""

    def __init__(self) -> None:
        self.found = {"imports": memory()}

    def add(self, name: str) -> None:
        self.found[name] = memory()


def epoch_sizes(learner: Learner) -> list[int]:
    """Episodes of each epoch until there are a million transitions."""
    episodes, per_epoch = TRANSITIONS // learner.shapes.episode_ticks, 256
    sizes = [per_epoch] * (episodes // per_epoch)
    return sizes + [episodes - sum(sizes)] * (sum(sizes) < episodes)


def training_setup(preset: str, *overrides: str) -> AbstractContextManager[TrainingSetup]:
    return open_training_setup(
        load_config("push", preset=preset, overrides=overrides, device="cpu")
    )


def full() -> dict[str, Any]:
    """Fill both replays as a run does."""
    stages = Stages()
    with training_setup("paper", *FEW_STEPS) as setup:
        learner = setup.learner
        recorded = record(setup.env)
        stages.add("robot, simulator and learner")
        for epoch, count in enumerate(epoch_sizes(learner)):
            learner.add_real(list(variations(recorded, count, epoch)))
        stages.add(f"{learner.real.replay.num_transitions:,} real")
        filled = False
        while not filled:  # whole epochs, each of which adds 200,000 imagined transitions
            filled = learner.imagined.level == TRANSITIONS  # then one more, which refills all
            learner.add_real(list(variations(recorded, 256, learner.epoch)))
            learner.learn()
            stages.add(f"{learner.imagined.level:,} imagined" + ", all of them anew" * filled)
        for _ in range(3):
            learner.ddpg.update_block(learner.sample_block(BLOCK), BLOCK)
        stages.add(f"updates from {BLOCK} batches that are drawn together")
        learner.state_dict()
        stages.add("state for a checkpoint")
    return stages.found


def state_of_full(learner: Learner, recorded: Sequence[Episode]) -> dict[str, Any]:
    """State of a run with full replays, from a new run."""
    learner.add_real(list(variations(recorded, 256, 0)))
    learner.learn()
    state = learner.state_dict()
    state["epoch"] = len(epoch_sizes(learner))
    state["imagined"]["level"] = TRANSITIONS
    return state


def restored(*, streamed: bool = False) -> dict[str, Any]:
    """Resume a run, and run its first epoch, which refills the imaginary source."""
    stages = Stages()
    with training_setup("paper", *FEW_STEPS) as setup:
        learner = setup.learner
        recorded = record(setup.env)
        state = state_of_full(learner, recorded)
        stages.add("robot, simulator, learner and one epoch")
        sizes = enumerate(epoch_sizes(learner))
        by_epoch: Any = (variations(recorded, count, epoch) for epoch, count in sizes)
        if not streamed:
            by_epoch = [list(episodes) for episodes in by_epoch]
            stages.add("episodes in memory")
        learner.load_state_dict(state, by_epoch)
        stages.add(f"{learner.real.replay.num_transitions:,} real restored")
        del by_epoch
        gc.collect()
        stages.add("episodes released")
        learner.add_real(list(variations(recorded, 256, 1_000)))
        learner.learn()
        stages.add("the next epoch")
    return stages.found


def streamed() -> dict[str, Any]:
    return restored(streamed=True)


def soak() -> dict[str, Any]:
    """Short epochs of full replays: each adds real episodes, imagines, learns and diagnoses."""
    overrides = (
        *FEW_STEPS,
        f"learner.replay.capacity={SOAK_CAPACITY}",
        "learner.schedule.cycles=25",
        "learner.schedule.policy_copy_cycles=25",
    )
    with training_setup("paper", *overrides) as setup:
        learner = setup.learner
        recorded = record(setup.env)
        unseen = list(variations(recorded, 20, 0))
        rng = np.random.default_rng(0)
        learner.add_real(list(variations(recorded, SOAK_CAPACITY // 50, 1)))
        points: list[tuple[float, float]] = []
        imagined = 0
        while imagined < SOAK_TRANSITIONS:
            episodes = list(variations(recorded, 8, learner.epoch + 2))
            learner.add_real(with_holes(episodes, rng))
            refilled = learner.imagined.level
            before = learner.imagined.collected
            learner.learn()
            diagnose(learner, unseen)
            learner.state_dict()
            if refilled == SOAK_CAPACITY:  # full: memory should not grow from here on
                imagined += refilled + learner.imagined.collected - before
                points.append((imagined / 1e6, memory()["now"]))
    return growth(points, "million imagined transitions")


def short() -> dict[str, Any]:
    """Epochs of four episodes with all that the preset has, but fewer updates.

    The replay is far from full: the episodes themselves add about 40 kB per epoch.
    """
    overrides = ("learner.schedule.updates_per_step=0.2", "learner.contact.updates_per_step=0.2")
    with training_setup("default", *overrides) as setup:
        learner = setup.learner
        recorded = record(setup.env)
        rng = np.random.default_rng(0)
        points = []
        for epoch in range(1, SHORT_EPOCHS + 1):
            learner.add_real(with_holes(list(variations(recorded, 4, epoch)), rng))
            learner.learn()
            learner.state_dict()
            points.append((float(epoch), memory()["now"]))
    return growth(points, "epoch")


def rows() -> dict[str, Any]:
    """Memory of what is compiled and cached per row count."""
    stages = Stages()
    with training_setup("paper") as setup, torch.no_grad():
        model = setup.learner.ensemble.members[0]
        inputs = torch.randn(4_000, model[0].in_features)
        counts = np.random.default_rng(0).permutation(len(inputs))[:300]
        model(inputs)
        stages.add("one number of rows")
        for count in counts:
            in_blocks(model, inputs[:count])
        stages.add("300 numbers of rows, in blocks")
        for count in counts:
            model(inputs[:count])
        stages.add("300 numbers of rows, all rows at once")
    return stages.found


def growth(points: Sequence[tuple[float, float]], unit: str) -> dict[str, Any]:
    """Whether memory grew: medians of fifths, and the slope after the first fifth."""
    fifth = len(points) // 5
    fifths = [
        statistics.median(mb for _, mb in points[i * fifth : (i + 1) * fifth]) for i in range(5)
    ]
    slope = statistics.linear_regression(*zip(*points[fifth:], strict=True)).slope
    return {
        "median of each fifth": [round(mb, 1) for mb in fifths],
        "last fifth less the second": round(fifths[4] - fifths[1], 1),
        f"bytes a {unit}": round(1e6 * slope),
        "peak": memory()["peak"],
        f"points: {unit}s and MB": [(round(x, 3), mb) for x, mb in points],
    }


MEASUREMENTS: dict[str, Callable[[], dict[str, Any]]] = {
    each.__name__: each for each in (full, restored, streamed, soak, short, rows)
}


def in_own_process(measurement: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(measurement).result()


def show(found: dict[str, Any]) -> None:
    for name, value in found.items():
        if isinstance(value, dict):
            print(f"  {name:60s} {value['now']:8,.0f} MB   peak {value['peak']:8,.0f} MB")
        elif not name.startswith("points"):
            print(f"  {name:60s} {value}")


def main() -> None:
    """Run the measurements."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=MEASUREMENTS, default=list(MEASUREMENTS))
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    document = collect_provenance(sys.argv, 0, datetime.now().astimezone())
    for name in options.only:
        started = time.perf_counter()
        document[name] = in_own_process(MEASUREMENTS[name])
        print(f"{name}, {time.perf_counter() - started:.0f} s")
        show(document[name])
        sys.stdout.flush()
        if options.out is not None:
            options.out.parent.mkdir(parents=True, exist_ok=True)
            options.out.write_text(json.dumps(document, indent=2) + "\n")


if __name__ == "__main__":
    main()
