"""Speed benchmark of the parts of a training run on this machine, against other libraries.

python -m bench.speed [--rounds 5] [--threads 1] [--device cpu] [--only TOPIC ...] [--out FILE]

updates      gradient updates against Stable-Baselines3 and sbx, and with a growing replay
imagination  imagined transitions, and a refill of a million, with intrinsic rewards
dynamics     training steps of the ensemble of models
simulation   control ticks against gymnasium-robotics, and inverse kinematics
memory       resident memory with full replays
reach        the total time to a solved Reach

In each round each contender is measured once, in alternating order. ``products alone`` is the time
of the matrix products of a unit of work at the rate measured on this machine in the same round for
the largest of them; ``takes`` is the measured time as a multiple of it. In the file, with
provenance, settings and the machine's load before, ``figures`` has a row for each contender:

topic, work, precision, who, unit, note   what was measured
median, min, max, all                     over rounds; null and [] where a contender is absent
ours_is                                   factor by which ours is better, for the others
products_s, times_products                seconds of the products alone, and the multiple of it
target, target_met                        for ours, where it has one; null without a figure

Without --out the file is bench/results/speed-DEVICE.json, or none where only a part was measured.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from datetime import datetime
from pathlib import Path
from typing import Any

import torch
from rich.console import Console

from bench.speed import dynamics, imagination, memory, reach, simulation, updates
from bench.speed.machine import with_this_machine
from bench.speed.precision import PRECISIONS
from bench.speed.results import rows, table
from bench.speed.rounds import run_rounds
from bench.speed.settings import Settings
from iher_robot.storage.provenance import collect_provenance

TOPICS = {
    "updates": updates.comparisons,
    "imagination": imagination.comparisons,
    "dynamics": dynamics.comparisons,
    "simulation": simulation.comparisons,
    "memory": memory.comparisons,
    "reach": reach.comparisons,
}
WIDTH = 220  # wide enough for every row


def measure(topic: str, settings: Settings) -> list[dict[str, Any]]:
    """Rows of one topic; prints progress to standard error."""
    started = time.perf_counter()

    def report(number: int) -> None:
        past = f"{time.perf_counter() - started:.0f} s"
        print(f"{topic}: round {number} of {settings.rounds}, {past}", file=sys.stderr, flush=True)

    with TOPICS[topic](settings) as comparisons:
        found = run_rounds(comparisons, settings, report)
    return [row for each in found for row in rows(each, with_targets=not settings.quick)]


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m bench.speed",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=1, help="of torch and of JAX")
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu")
    parser.add_argument("--precision", nargs="+", choices=PRECISIONS, default=["fp32", "bf16"])
    parser.add_argument("--only", nargs="+", choices=TOPICS, default=list(TOPICS))
    parser.add_argument("--out", type=Path)
    parser.add_argument("--quick", action="store_true", help="check that it runs; no valid speeds")
    options = parser.parse_args()
    if options.out is None and options.only == list(TOPICS) and not options.quick:
        options.out = Path(f"bench/results/speed-{options.device}.json")
    return options


def main() -> None:
    """Measure, print and save."""
    options = parse()
    torch.set_num_threads(options.threads)
    settings = Settings(
        rounds=options.rounds,
        threads=options.threads,
        device=torch.device(options.device),
        precisions=tuple(PRECISIONS[name] for name in options.precision),
        quick=options.quick,
    )
    provenance = collect_provenance(sys.argv, 0, datetime.now().astimezone())
    document = with_this_machine(provenance) | {
        "rounds": options.rounds,
        "threads": options.threads,
        "device": options.device,
        "quick": options.quick,
        "load before": os.getloadavg()[0],
    }
    figures: list[dict[str, Any]] = []
    for topic in options.only:
        figures += measure(topic, settings)
        if options.out is not None:  # partial results, should the next topic fail
            options.out.parent.mkdir(parents=True, exist_ok=True)
            options.out.write_text(json.dumps(document | {"figures": figures}, indent=2) + "\n")
    Console(width=None if sys.stdout.isatty() else WIDTH).print(table(figures))


if __name__ == "__main__":
    main()
