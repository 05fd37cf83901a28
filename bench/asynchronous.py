"""Benchmark of learning time on a served robot, with asynchronous and synchronous learning.

python bench/asynchronous.py --task reach [--seeds 0 1 2] [--modes async sync] [--set KEY=VALUE]
    [--budget-minutes M] [--until-success 0.9] [--out bench/results/async.json]

For each seed and mode in turn: a host process (iher-robot serve) on loopback, whose simulated robot
moves in real time, and iher-robot train as its client. A task is solved when two evaluations in a
row on the robot reach the rate of --until-success; the run ends there. --out keeps the file's
entries of other tasks, seeds and modes, so that parts can be run separately; a run of Push takes
about 15 minutes. Wall clock includes resets, evaluation and learning.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from bench.programs import host
from iher_robot.storage.accounts import read_accounts
from iher_robot.storage.episode_reader import EpisodeReader
from iher_robot.storage.provenance import collect_provenance

PERIOD_S = 0.04
COLUMNS = (
    "solved after wall s",
    "solved after robot min",
    "wall s",
    "epochs",
    "motion s",
    "evaluation s",
    "reset s",
    "idle s",
    "ticks",
    "ticks missed",
    "ticks invalid",
    "tick jitter ms, p50",
    "tick jitter ms, p99",
)


def one_run(task: str, mode: str, seed: int, train_options: Sequence[str]) -> dict[str, float]:
    """Train once and return the measurements."""
    with tempfile.TemporaryDirectory() as scratch, host(Path(scratch) / "memory") as (endpoint, _):
        out = Path(scratch) / "run"
        command = [sys.executable, "-m", "iher_robot", "train", "--driver", "zenoh"]
        command += ["--connect", endpoint, "--task", task, "--seed", str(seed), f"--{mode}"]
        command += ["--out", str(out), "--quiet", *train_options]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(f"training ended with {done.returncode}: {done.stderr}")
        return read_run(out)


def read_run(out: Path) -> dict[str, float]:
    """Measurements of a finished run; the time to a solution is nan without one."""
    rows = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    solved = solved_row(rows, target_rate(out))
    spent = read_accounts(out / "ledger.sqlite").spent
    with EpisodeReader(out / "episodes") as reader:
        motion = [stored for stored in reader if stored.account == "motion"]
    timed = [row for row in rows if "tick_jitter_p99_ms" in row]
    return {
        "solved after wall s": solved.get("wall_seconds", float("nan")),
        "solved after robot min": solved.get("robot_minutes", float("nan")),
        "wall s": rows[-1]["wall_seconds"],
        "epochs": len(rows),
        **{f"{name} s": PERIOD_S * ticks for name, ticks in spent.items() if name != "deployment"},
        "ticks": sum(len(stored.episode) for stored in motion),
        "ticks missed": sum(row["ticks_missed"] for row in timed),
        "ticks invalid": sum(int((~stored.episode.valid).sum()) for stored in motion),
        "tick jitter ms, p50": statistics.median(row["tick_jitter_p50_ms"] for row in timed),
        "tick jitter ms, p99": statistics.median(row["tick_jitter_p99_ms"] for row in timed),
    }


def target_rate(out: Path) -> float:
    lines = (out / "config.yaml").read_text().splitlines()
    return float(next(line for line in lines if line.startswith("until_success")).split()[1])


def solved_row(rows: Sequence[dict[str, float]], rate: float) -> dict[str, float]:
    """The second of the first two evaluations in a row that reached a rate; empty without them."""
    evaluated = [row for row in rows if "success" in row]
    for before, after in itertools.pairwise(evaluated):
        if min(before["success"], after["success"]) >= rate:
            return after
    return {}


def table(runs: Sequence[dict[str, Any]], modes: Sequence[str]) -> str:
    """Medians over seeds, with minimum and maximum."""
    lines = [f"{'':26s}" + "".join(f"{mode:>30s}" for mode in modes)]
    for name in COLUMNS:
        line = f"{name:26s}"
        for mode in modes:
            values = [run[name] for run in runs if run["mode"] == mode]
            cell = ""
            if values:
                middle = statistics.median(values)
                cell = f"{middle:,.2f}  ({min(values):,.2f} to {max(values):,.2f})"
            line += f"{cell:>30s}"
        lines.append(line.rstrip())
    return "\n".join(lines)


def main() -> None:
    """Run each seed in each mode and print medians."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", default="reach")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--modes", nargs="+", default=["sync", "async"], choices=["sync", "async"])
    parser.add_argument("--budget-minutes", type=float)
    parser.add_argument("--until-success", type=float, default=1.0)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="overrides")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    train_options = ["--until-success", str(options.until_success)]
    if options.budget_minutes is not None:
        train_options += ["--budget-minutes", str(options.budget_minutes)]
    for override in options.overrides:
        train_options += ["--set", override]
    runs: list[dict[str, Any]] = []
    for seed in options.seeds:
        for mode in options.modes:
            provenance = collect_provenance(sys.argv, seed, datetime.now().astimezone())
            provenance["versions"] |= {n: version(n) for n in ("eclipse-zenoh", "msgpack")}
            load = os.getloadavg()[0]
            row = one_run(options.task, mode, seed, train_options)
            about = {"task": options.task, "mode": mode, "options": train_options}
            runs.append(provenance | about | {"load before": load} | row)
            print(f"seed {seed}, {mode}: {row}", flush=True)
            if options.out is not None:
                keep(options.out, runs[-1])
    print(table(runs, options.modes))


def keep(path: Path, run: dict[str, Any]) -> None:
    """Replace the run of the same task, seed and mode in a file."""
    kept = json.loads(path.read_text())["runs"] if path.exists() else []
    key = ("task", "mode", "seed")
    kept = [other for other in kept if [other[k] for k in key] != [run[k] for k in key]]
    kept.append(run)
    kept.sort(key=lambda other: [str(other[k]) for k in key])
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"runs": kept}, indent=2) + "\n")


if __name__ == "__main__":
    main()
