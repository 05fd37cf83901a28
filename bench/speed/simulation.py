"""Control ticks of simulated robots, with resets, and inverse kinematics."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import AsyncVectorEnv, AutoresetMode

from bench.speed.comparison import Comparison, Contender, Kind, Target
from bench.speed.learners import learner_of_push
from bench.speed.official import make_official
from bench.speed.settings import Settings
from iher_robot.config.options import load_config
from iher_robot.env.goal_env import GoalRobotEnv, make_env
from iher_robot.learning.goal_model import REAL
from iher_robot.learning.learner import Learner
from iher_robot.learning.policy import Policy
from iher_robot.rollout.simulators.pool import SimulatorPool
from iher_robot.training.setup import CPU

EPISODE_TICKS = 50
RATIO = 1.3
VECTOR = "gymnasium-robotics, asynchronous"


@contextmanager
def comparisons(settings: Settings) -> Iterator[list[Comparison]]:
    """Physics with a mocap body, physics with motors, and inverse kinematics."""
    episodes = settings.sized(8, 1)
    with ExitStack() as stack:
        joint = stack.enter_context(make_env("push"))
        motors = Contender("iher_robot, one fetch", partial(ticks_per_second, joint, episodes))
        solver = Contender("iher_robot", partial(solves_per_second, joint, episodes))
        yield [
            *mocap_comparisons(stack, settings, episodes),
            comparison("control ticks, motors in the joints", "ticks/s", (motors,)),
            comparison("inverse kinematics, median of a random motion", "solves/s", (solver,)),
        ]


def mocap_comparisons(stack: ExitStack, settings: Settings, episodes: int) -> list[Comparison]:
    """One robot with random actions, and many robots with a policy."""
    mocap = stack.enter_context(make_env("push", actuation="mocap"))
    official = make_official()
    stack.callback(official.close)
    learner = learner_of_push(settings, settings.precisions[0], ())
    act = BatchActor(learner.acting_policy(CPU))
    cores = len(os.sched_getaffinity(0))
    at_random, with_policy = [], []
    for workers in settings.sized([cores, 2 * cores], [1]):
        vector = AsyncVectorEnv([make_official] * workers, autoreset_mode=AutoresetMode.SAME_STEP)
        stack.callback(vector.close)
        name, ticks = f"{VECTOR}, {workers} robots", ticks_per_second_of_vector
        at_random.append(Contender(name, partial(ticks, vector, episodes, None)))
        with_policy.append(Contender(name, partial(ticks, vector, episodes, act)))
    ours = Contender("iher_robot, one fetch-mocap", partial(ticks_per_second, mocap, episodes))
    theirs = Contender(
        "gymnasium-robotics, gym.make", partial(ticks_per_second, official, episodes)
    )
    many = many_simulators(stack, learner, cores, episodes)
    return [
        comparison(
            "control ticks, mocap physics, random actions", "ticks/s", (ours, theirs, *at_random)
        ),
        comparison(
            "episodes of a policy, mocap physics, control ticks",
            "ticks/s",
            (many, *with_policy),
            Target(f"{RATIO:g} x {VECTOR}", rival=VECTOR, ratio=RATIO),
        ),
    ]


def comparison(
    work: str, unit: str, contenders: tuple[Contender, ...], target: Target | None = None
) -> Comparison:
    return Comparison("simulation", work, unit, Kind.RATE, contenders, target=target)


class BatchActor:
    """A policy on the CPU that acts on the observations of several robots."""

    def __init__(self, policy: Policy) -> None:
        self._policy = policy

    def __call__(self, observation: Mapping[str, np.ndarray]) -> np.ndarray:
        seen, goal = (
            torch.as_tensor(observation[name], dtype=torch.float32)
            for name in ("observation", "desired_goal")
        )
        return self._policy.act(seen, goal, torch.full((len(seen),), REAL)).numpy()


def many_simulators(stack: ExitStack, learner: Learner, cores: int, episodes: int) -> Contender:
    simulators = max(2, cores)
    config = load_config("push", preset="paper", simulators=simulators, robot="fetch-mocap")
    pool = stack.enter_context(SimulatorPool(config, EPISODE_TICKS))
    count = episodes * simulators

    def measure(round_number: int) -> float:
        first = 1_000 * round_number
        started = time.perf_counter()
        for _ in pool.run(learner, range(first, first + count)):
            pass
        return count * EPISODE_TICKS / (time.perf_counter() - started)

    measure(0)  # warm-up: start of the processes
    return Contender(f"iher_robot, {simulators} simulators", measure)


def ticks_per_second(env: gym.Env, episodes: int, round_number: int) -> float:
    actions = random_actions(round_number, EPISODE_TICKS)
    started = time.perf_counter()
    for episode in range(episodes):
        env.reset(seed=1_000 * round_number + episode)
        for action in actions:
            env.step(action)
    seconds = time.perf_counter() - started
    if isinstance(env, GoalRobotEnv):
        env.hold()
    return episodes * EPISODE_TICKS / seconds


def ticks_per_second_of_vector(
    env: AsyncVectorEnv, episodes: int, act: BatchActor | None, round_number: int
) -> float:
    """Ticks of all environments together; each resets itself in its last step."""
    actions = random_actions(round_number, EPISODE_TICKS, env.num_envs)
    started = time.perf_counter()
    observation, _ = env.reset(seed=round_number)
    for episode in range(episodes):
        # The last episode ends without a reset.
        for action in actions[: EPISODE_TICKS - (episode == episodes - 1)]:
            observation, *_ = env.step(action if act is None else act(observation))
    seconds = time.perf_counter() - started
    return (episodes * EPISODE_TICKS - 1) * env.num_envs / seconds


def random_actions(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (*shape, 4)).astype(np.float32)


def solves_per_second(env: GoalRobotEnv, episodes: int, round_number: int) -> float:
    """Inverse of the median time of a joint command for an action."""
    actions = random_actions(round_number, EPISODE_TICKS)
    times = []
    for episode in range(episodes):
        env.reset(seed=1_000 * round_number + episode)
        for action in actions:
            state = env.driver.read()
            started = time.perf_counter()
            env.controller.command(action, state)
            times.append(time.perf_counter() - started)
            env.step(action)
    env.hold()
    return 1.0 / statistics.median(times)
