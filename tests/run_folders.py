"""Folders of runs, created without training."""

from __future__ import annotations

import datetime
import functools
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from iher_robot.config.options import load_config
from iher_robot.config.robot import choose_robot
from iher_robot.config.run import dump_config
from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.learning.episode import Episode
from iher_robot.storage.accounts import Account
from iher_robot.storage.episode import DONE, StoredEpisode
from iher_robot.storage.episode_store import EpisodeStore
from iher_robot.storage.interface import keep_interface
from iher_robot.storage.ledger import Ledger
from iher_robot.storage.provenance import write_provenance
from iher_robot.storage.run_directory import RunDirectory
from tasks import make_task

PERIOD_S = 0.04


def make_stored(
    seed: int,
    *,
    task: str = "reach",
    valid: Sequence[bool] = (True,) * 6,
    account: Account = "motion",
    epoch: int = 1,
    ended: str = DONE,
    success: bool = False,
) -> StoredEpisode:
    """An episode of random numbers, which reaches its goal at the end or never."""
    rng = np.random.default_rng(seed)
    made, length = make_task(task), len(valid)
    observations = rng.normal(size=(length + 1, made.layout.obs_dim))
    goal = rng.normal(size=made.goal_dim) + 100.0
    if success:
        observations[-1, list(made.goal_model.achieved_entries)] = goal
    elapsed = np.where(valid, 1, rng.integers(1, 4, length))
    requested = rng.uniform(-1, 1, size=(length, 4)).astype(np.float32)
    clipped = rng.random(length) < 0.3
    return StoredEpisode(
        epoch=epoch,
        policy_source=int(rng.integers(2)),
        account=account,
        seed=int(rng.integers(2**32)),
        entry=1,
        index=0,
        ended=ended,
        seqs=7 + np.cumsum(elapsed),
        elapsed=elapsed,
        episode=Episode(
            observations=observations,
            actions=np.where(clipped[:, None], requested / 2, requested),
            requested_actions=requested,
            valid=np.array(valid, dtype=bool),
            desired_goal=goal,
        ),
    )


def record_episode(env: GoalRobotEnv, seed: int, ticks: int = 50) -> StoredEpisode:
    """Run an episode of random actions, each held for some ticks, on the simulated robot."""
    rng = np.random.default_rng(seed)
    start, _ = env.reset(seed=seed)
    actions = np.repeat(rng.uniform(-1, 1, (-(-ticks // 5), 4)), 5, axis=0)[:ticks]
    actions = actions.astype(np.float32)
    after = [env.step(action)[0]["observation"] for action in actions]
    stored = make_stored(seed, task=env.task.name, valid=(True,) * ticks)
    episode = replace(
        stored.episode,
        observations=np.stack([start["observation"], *after]),
        actions=actions,
        requested_actions=actions,
        desired_goal=start["desired_goal"],
    )
    return replace(stored, seed=seed, episode=episode)


def make_run(
    path: Path,
    episodes: Iterable[StoredEpisode] = (),
    *,
    task: str = "reach",
    robot: str = "fetch-mocap",
    **settings: Any,
) -> list[StoredEpisode]:
    """Create the folder of a run with episodes; return them as stored."""
    config = load_config(task, robot=robot, **settings)
    directory = RunDirectory.create(path, dump_config(config))
    keep_interface(directory.episodes_path, interface(task, robot))
    now = datetime.datetime(2026, 1, 2, 3, 4, 5, tzinfo=datetime.UTC)
    origin = {"commit": "c0ffee", "dirty": True, "started": now.isoformat(), "versions": {}}
    write_provenance(directory.provenance_path, origin)
    stored = [replace(one, index=index) for index, one in enumerate(episodes)]
    with Ledger(directory.ledger_path) as ledger, EpisodeStore(directory.episodes_path) as store:
        for one in stored:
            with ledger.reserve(one.account, 200) as entry:
                store.append(one)
                entry.settle(int(one.elapsed.sum()))
    return stored


@functools.cache
def interface(task: str, robot: str) -> dict[str, Any]:
    """Policy interface of a simulated robot."""
    return choose_robot("mujoco", robot).make_env(task).policy_interface()  # it is never opened
