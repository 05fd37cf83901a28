"""Real episodes for benchmarks: recorded with random actions, and varied by noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.learning.episode import Episode
from iher_robot.rollout.episode import run_episode
from iher_robot.rollout.recorder import Recorder
from tests.random_actor import RandomActor

RECORDED = 64
NOISE = 1e-3


def record(env: GoalRobotEnv) -> list[Episode]:
    """Episodes of random actions."""
    actor, episodes = RandomActor(0), []
    for index in range(RECORDED):
        recorder = Recorder()
        run_episode(env, actor, recorder, seed=index, ticks=env.task.episode_ticks)
        episode = recorder.episode()
        assert episode is not None
        episodes.append(episode)
    return episodes


def variations(recorded: Sequence[Episode], count: int, seed: int) -> Iterator[Episode]:
    """A number of different episodes, each with its own arrays as if read from a file."""
    rng = np.random.default_rng(seed)
    for index in range(count):
        like = recorded[index % len(recorded)]
        observations = like.observations + NOISE * rng.standard_normal(like.observations.shape)
        copies = (a.copy() for a in (like.actions, like.requested_actions, like.valid))
        yield Episode(observations, *copies, like.desired_goal.copy())


def with_holes(episodes: Sequence[Episode], rng: np.random.Generator) -> list[Episode]:
    """Mark a few ticks invalid, so that row counts vary."""
    for episode in episodes:
        episode.valid[rng.random(len(episode)) < 0.01] = False
    return list(episodes)
