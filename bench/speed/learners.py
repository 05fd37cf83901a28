"""Our learners, filled with real episodes of random actions."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import islice

from bench.episodes import record, variations
from bench.speed.precision import Precision
from bench.speed.settings import Settings
from iher_robot.config.options import load_config
from iher_robot.env.goal_env import make_env
from iher_robot.learning.episode import Episode
from iher_robot.learning.learner import Learner
from iher_robot.training.setup import make_learner
from tasks import GoalTask

OURS = "iher_robot"
EPISODES_AN_EPOCH = 256
FEW_STEPS = (
    "learner.schedule.dynamics_steps=1",
    "learner.schedule.first_epoch_dynamics_factor=1",
    "learner.schedule.cycles=1",
    "learner.schedule.batches=1",
)
OBSERVATION, GOAL, ACTION = 25, 3, 4
"""Dimensions of Push."""


@cache
def recorded() -> tuple[GoalTask, list[Episode]]:
    """The task Push, and 3,200 transitions of it."""
    env = make_env("push", actuation="mocap")
    with env:
        episodes = record(env)
    return env.task, episodes


def learner_of_push(settings: Settings, precision: Precision, overrides: Sequence[str]) -> Learner:
    """An untrained learner with the sizes of the preset ``paper`` and some real episodes."""
    task, episodes = recorded()
    graphs = ["learner.cuda_graphs=true"] if settings.device.type == "cuda" else []
    config = load_config(
        "push", preset="paper", overrides=[*overrides, *precision.overrides, *graphs]
    )
    learner = make_learner(config, task, settings.device)
    learner.add_real(episodes)
    return learner


def learner_with_models(settings: Settings, precision: Precision) -> Learner:
    """A learner whose models can imagine, after an epoch of minimal length."""
    learner = learner_of_push(settings, precision, FEW_STEPS)
    with precision.on_this_process():
        learner.learn()
    return learner


def fill(learner: Learner, transitions: int) -> None:
    """Add real episodes up to a number of stored transitions."""
    _, episodes = recorded()
    missing = (transitions - learner.real.replay.num_transitions) // learner.shapes.episode_ticks
    more = variations(episodes, missing, seed=0)
    while batch := list(islice(more, EPISODES_AN_EPOCH)):
        learner.add_real(batch)
