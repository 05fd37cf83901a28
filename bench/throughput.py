"""How fast the parts of a training run are on this machine, each interleaved with its rival.

python bench/throughput.py [--rounds 5] [--threads 1] [--out bench/results/NAME.json]
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch

import iher_robot  # noqa: F401 (registers the environments)
from iher_robot.config import load_config
from iher_robot.env import GoalRobotEnv, make_env
from iher_robot.learning.episode import Episode
from iher_robot.learning.goal_model import Shapes
from iher_robot.learning.learner import Learner
from iher_robot.provenance import collect_provenance

EPISODES = 64


def steps_per_second(env: gym.Env, episodes: int = 4) -> float:
    """Control ticks a second with random actions, resets included."""
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (50, 4)).astype(np.float32)
    started = time.perf_counter()
    for episode in range(episodes):
        env.reset(seed=episode)
        for action in actions:
            env.step(action)
    return episodes * len(actions) / (time.perf_counter() - started)


def inverse_kinematics_ms(env: GoalRobotEnv, ticks: int = 500) -> dict[str, float]:
    """Times of one joint command from an action, over a random motion."""
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    times = []
    for tick in range(ticks):
        if tick % env.episode_ticks == 0:
            env.reset(seed=tick)
        action, state = rng.uniform(-1, 1, 4), env.driver.read()
        started = time.perf_counter()
        env.controller.command(action, state)
        times.append(1e3 * (time.perf_counter() - started))
        env.step(action)
    env.hold()
    return {
        "inverse kinematics ms, p50": float(np.percentile(times, 50)),
        "inverse kinematics ms, p99": float(np.percentile(times, 99)),
    }


def random_episodes(env: GoalRobotEnv, count: int) -> list[Episode]:
    """Real episodes of random actions, to fill the learner with."""
    rng = np.random.default_rng(0)
    episodes = []
    for index in range(count):
        observation, _ = env.reset(seed=index)
        observations = [observation["observation"]]
        actions = rng.uniform(-1, 1, (env.task.episode_ticks, 4)).astype(np.float32)
        for action in actions:
            observations.append(env.step(action)[0]["observation"])
        valid = np.ones(len(actions), dtype=bool)
        goal = observation["desired_goal"]
        episodes.append(Episode(np.stack(observations), actions, actions, valid, goal))
    env.driver.disarm()
    return episodes


def rate(work: Callable[[], object], times: int) -> float:
    """Repetitions a second."""
    started = time.perf_counter()
    for _ in range(times):
        work()
    return times / (time.perf_counter() - started)


def make_learner(env: GoalRobotEnv, precision: str) -> Learner:
    """A learner of Push with the paper's sizes that has seen some episodes."""
    overrides = ["learner.schedule.dynamics_steps=1", "learner.schedule.cycles=1"]
    config = load_config("push", "paper", "iher", overrides).learner
    shapes = Shapes(env.task.layout.obs_dim, env.task.goal_dim, 4, env.task.episode_ticks)
    learner = Learner(shapes, env.task.goal_model, config, seed=0, device=torch.device("cpu"))
    learner.add_real(random_episodes(env, EPISODES))
    torch.set_float32_matmul_precision(precision)
    learner.learn()
    return learner


def measure(learner: Learner, precision: str) -> dict[str, float]:
    """Rates of the learner's parts in one precision of matrix products."""
    torch.set_float32_matmul_precision(precision)
    batch = learner.config.schedule.workers * learner.config.dynamics.batch_size
    starts = learner.real.start_observations()

    def train_dynamics() -> None:
        learner.ensemble.train(learner.real, 1, batch_size=batch, generator=learner.generator)

    def imagine() -> None:
        learner.imagined.add_rollouts(learner.ensemble, learner.policy, starts, 1_000, epoch=1)

    left, right = torch.randn(2048, 256), torch.randn(256, 256)
    return {
        f"policy updates/s, batch 2048, {precision}": rate(
            lambda: learner.ddpg.update(learner.sample_batches(1)[0]), 20
        ),
        f"dynamics steps/s, 5 x 4096, {precision}": rate(train_dynamics, 3),
        f"imagined transitions/s, 5 members, {precision}": 50_000 * rate(imagine, 1),
        f"matrix product GFLOP/s, 2048 x 256 x 256, {precision}": rate(lambda: left @ right, 50)
        * 2
        * 2048
        * 256
        * 256
        / 1e9,
    }


def main() -> None:
    """Measure in rounds and print medians."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    import gymnasium_robotics

    gym.register_envs(gymnasium_robotics)
    ours, official = make_env("push", actuation="mocap"), gym.make("FetchPush-v4")
    joint = make_env("push")
    learner = make_learner(ours, "medium")
    found: dict[str, list[float]] = {}
    for _ in range(options.rounds):
        row = {
            "environment steps/s, iher_robot, joint actuation": steps_per_second(joint),
            "environment steps/s, iher_robot, mocap actuation": steps_per_second(ours),
            "environment steps/s, gymnasium-robotics through gym.make": steps_per_second(official),
        }
        row |= inverse_kinematics_ms(joint)
        for precision in ("medium", "highest"):
            row |= measure(learner, precision)
        for name, value in row.items():
            found.setdefault(name, []).append(value)
    for env in (ours, joint):
        env.close()
    medians = {name: statistics.median(values) for name, values in found.items()}
    for name, value in medians.items():
        low, high = min(found[name]), max(found[name])
        print(f"{name:62s} {value:10,.2f}   ({low:,.2f} to {high:,.2f})")
    if options.out is not None:
        provenance = collect_provenance(sys.argv, 0, datetime.now().astimezone())
        document = provenance | {"threads": options.threads, "median": medians, "all": found}
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(json.dumps(document, indent=2) + "\n")


if __name__ == "__main__":
    main()
