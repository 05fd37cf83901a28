"""Cost of storing every tick: ticks of a simulated robot in memory, and stored on disk.

Three modes take turns in one process: in memory (as an evaluation in simulation), stored as by a
run in simulation, and stored as on a robot, where each tick waits for the disk.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from iher_robot.env.goal_env import GoalRobotEnv, make_env
from iher_robot.rollout.durable_recorder import DurableRecorder
from iher_robot.rollout.episode import run_episode
from iher_robot.rollout.observer import EpisodeObserver, EpisodeStart, Transition
from iher_robot.rollout.recorder import Recorder
from iher_robot.storage.episode import EpisodeHeader
from iher_robot.storage.episode_store import EpisodeStore
from iher_robot.storage.ledger import Ledger
from iher_robot.storage.provenance import commit, machine, versions
from tests.random_actor import RandomActor

TICKS = 50
MODES = ("memory", "kept", "kept durably")


class RunStorage:
    """A folder that stores episodes as a run does."""

    def __init__(self, folder: Path, env: GoalRobotEnv, durable: bool, stack: ExitStack) -> None:
        folder.mkdir()
        self._env = env
        self._ledger = stack.enter_context(Ledger(folder / "ledger.sqlite"))
        self._store = stack.enter_context(EpisodeStore(folder / "episodes", durable_ticks=durable))

    def recorder(self, seed: int) -> DurableRecorder:
        return DurableRecorder(
            self._env,
            self._store,
            partial(self._ledger.reserve, "motion", TICKS, counted=True),
            self._ledger,
            lambda source, entry: EpisodeHeader(1, source, "motion", seed, entry),
        )


class Stopwatch(EpisodeObserver):
    """Measures the time of each tick without the environment's step. Last of the observers."""

    def __init__(self, env: TimedEnv) -> None:
        self._env = env
        self._tick_start = 0.0
        self.times_ms: list[float] = []

    def start(self, start: EpisodeStart) -> None:  # noqa: ARG002
        self._tick_start = time.perf_counter()

    def after_tick(self, transition: Transition) -> None:  # noqa: ARG002
        now = time.perf_counter()
        self.times_ms.append(1e3 * (now - self._tick_start - self._env.seconds))
        self._tick_start = now


class TimedEnv:
    """An environment that measures its steps."""

    def __init__(self, env: GoalRobotEnv) -> None:
        self._env = env
        self.seconds = 0.0
        self.reset, self.hold, self.render = env.reset, env.hold, env.render

    def step(self, action: Any) -> Any:
        begun = time.perf_counter()
        try:
            return self._env.step(action)
        finally:
            self.seconds = time.perf_counter() - begun


def ticks_of(env: GoalRobotEnv, recorder: Recorder, seed: int) -> list[float]:
    """Milliseconds of each tick without the environment's step."""
    timed = TimedEnv(env)
    watch = Stopwatch(timed)
    run_episode(timed, RandomActor(seed), recorder, seed=seed, ticks=TICKS, observers=[watch])
    return watch.times_ms


def measure(folder: Path, rounds: int, episodes: int) -> dict[str, Any]:
    ticks: dict[str, list[float]] = {mode: [] for mode in MODES}
    rates: dict[str, list[float]] = {mode: [] for mode in MODES}
    with ExitStack() as stack:
        env = stack.enter_context(make_env("push", actuation="mocap"))
        kept = {
            mode: RunStorage(folder / mode, env, mode == "kept durably", stack)
            for mode in MODES[1:]
        }
        for round_number in range(rounds):
            for mode in MODES:
                begun = time.perf_counter()
                for index in range(episodes):
                    seed = 1000 * round_number + index
                    if mode == "memory":
                        ticks[mode] += ticks_of(env, Recorder(), seed)
                        continue
                    with kept[mode].recorder(seed) as recorder:
                        ticks[mode] += ticks_of(env, recorder, seed)
                rates[mode].append(episodes * TICKS / (time.perf_counter() - begun))
    return {
        mode: {
            "ticks_per_second": round(statistics.median(rates[mode]), 1),
            "beside_the_step_ms": {
                f"p{share}": round(float(np.percentile(ticks[mode], share)), 4)
                for share in (50, 99, 100)
            },
        }
        for mode in MODES
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--episodes", type=int, default=20, help="of 50 ticks, per mode and round")
    parser.add_argument("--folder", type=Path, help="on the disk to measure")
    parser.add_argument("--out", type=Path, default=Path("bench/results/journal.json"))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        measured = measure(Path(folder), options.rounds, options.episodes)
    for mode, figures in measured.items():
        print(
            f"{mode:14} {figures['ticks_per_second']:8.1f} ticks/s, "
            f"without the step, ms: {figures['beside_the_step_ms']}"
        )
    result = {
        "command": ["python", *sys.argv],
        "rounds": options.rounds,
        "episodes": options.episodes,
        "measured": measured,
        "versions": versions(),
        "machine": machine(),
        **commit(Path(__file__).parent),
    }
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
