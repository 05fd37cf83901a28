"""What keeping every tick costs: ticks of a simulated robot in memory, and kept on disk.

Three ways take turns in one process: in memory alone (as an evaluation in a simulator), kept as a
run in simulation keeps them, and kept as on a robot, where each tick waits for the disk.
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
WAYS = ("memory", "kept", "kept durably")


class Keeping:
    """A folder that keeps episodes as a run does."""

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
    """Measures each tick beside those of the environment's step. Last of the observers."""

    def __init__(self, env: TimedEnv) -> None:
        self._env = env
        self._turned = 0.0
        self.times_ms: list[float] = []

    def start(self, start: EpisodeStart) -> None:  # noqa: ARG002
        self._turned = time.perf_counter()

    def after_tick(self, transition: Transition) -> None:  # noqa: ARG002
        now = time.perf_counter()
        self.times_ms.append(1e3 * (now - self._turned - self._env.seconds))
        self._turned = now


class TimedEnv:
    """An environment that measures its step."""

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
    """Milliseconds of each tick beside those of the environment's step."""
    timed = TimedEnv(env)
    watch = Stopwatch(timed)
    run_episode(timed, RandomActor(seed), recorder, seed=seed, ticks=TICKS, observers=[watch])
    return watch.times_ms


def measure(folder: Path, rounds: int, episodes: int) -> dict[str, Any]:
    ticks: dict[str, list[float]] = {way: [] for way in WAYS}
    rates: dict[str, list[float]] = {way: [] for way in WAYS}
    with ExitStack() as stack:
        env = stack.enter_context(make_env("push", actuation="mocap"))
        kept = {way: Keeping(folder / way, env, way == "kept durably", stack) for way in WAYS[1:]}
        for round_number in range(rounds):
            for way in WAYS:
                begun = time.perf_counter()
                for index in range(episodes):
                    seed = 1000 * round_number + index
                    if way == "memory":
                        ticks[way] += ticks_of(env, Recorder(), seed)
                        continue
                    with kept[way].recorder(seed) as recorder:
                        ticks[way] += ticks_of(env, recorder, seed)
                rates[way].append(episodes * TICKS / (time.perf_counter() - begun))
    return {
        way: {
            "ticks_per_second": round(statistics.median(rates[way]), 1),
            "beside_the_step_ms": {
                f"p{share}": round(float(np.percentile(ticks[way], share)), 4)
                for share in (50, 99, 100)
            },
        }
        for way in WAYS
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--episodes", type=int, default=20, help="of 50 ticks, each way and round")
    parser.add_argument("--folder", type=Path, help="on the disk to measure")
    parser.add_argument("--out", type=Path, default=Path("bench/results/journal.json"))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        measured = measure(Path(folder), options.rounds, options.episodes)
    for way, figures in measured.items():
        print(
            f"{way:14} {figures['ticks_per_second']:8.1f} ticks/s, "
            f"beside the step, ms: {figures['beside_the_step_ms']}"
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
