"""Evaluation episodes: no noise, success at the last step."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import torch

from iher_robot.collect import Recorder, Stream, episode_seed, run_episode
from iher_robot.env import GoalRobotEnv
from iher_robot.learning.diagnostics import diagnose
from iher_robot.learning.episode import Episode
from iher_robot.learning.imaginary_source import Progress
from iher_robot.learning.learner import Learner
from iher_robot.learning.policy import Policy


@dataclass(frozen=True)
class Evaluation:
    """What a policy did in some episodes.

    Attributes:
        successes: Episodes whose last step met the goal.
        count: Episodes run.
        episodes: Those with at least one whole tick.
    """

    successes: int
    count: int
    episodes: list[Episode]

    @property
    def success_rate(self) -> float:
        """Share of successful episodes."""
        return self.successes / self.count


def run_evaluation(
    run_one: Callable[[int], Recorder],
    seeds: Iterable[int],
    on_episode: Callable[[int], None] | None = None,
) -> Evaluation:
    """Run one episode for each seed.

    Args:
        run_one: Runs the episode of a seed, without noise.
        seeds: Decide starts and goals.
        on_episode: Told how many episodes are done.

    Returns:
        Successes and the episodes.
    """
    recorded: list[Episode] = []
    successes = count = 0
    for seed in seeds:
        recorder = run_one(seed)
        count += 1
        successes += recorder.success
        episode = recorder.episode()
        if episode is not None:
            recorded.append(episode)
        if on_episode is not None:
            on_episode(count)
    return Evaluation(successes, count, recorded)


def run_simulated(simulator: GoalRobotEnv, policy: Policy, seed: int) -> Recorder:
    """Run an episode that costs nothing and is not kept.

    Args:
        simulator: Where.
        policy: A policy on the CPU.
        seed: Decides start and goal.
    """
    recorder = Recorder()
    run_episode(simulator, policy, recorder, seed=seed, ticks=simulator.task.episode_ticks)
    return recorder


def evaluate_learner(
    learner: Learner,
    run_one: Callable[[Policy, int], Recorder],
    *,
    run_seed: int,
    count: int,
    progress: Progress,
) -> dict[str, float]:
    """Success rate without noise, and what the models make of the same episodes.

    Args:
        learner: After the epoch that is judged.
        run_one: Runs the episode of a seed with a policy on the CPU, without noise.
        run_seed: Seed of the run.
        count: Episodes to run.
        progress: Told how many are done.

    Returns:
        Metrics.
    """
    # Numbers that follow from the epoch, so that a resumed run draws the same episodes.
    first = learner.epoch * count
    seeds = [episode_seed(run_seed, Stream.EVALUATION, first + i) for i in range(count)]
    policy = learner.acting_policy(torch.device("cpu"))
    evaluation = run_evaluation(
        lambda seed: run_one(policy, seed), seeds, lambda done: progress("evaluate", done, count)
    )
    return {"success": evaluation.success_rate} | diagnose(learner, evaluation.episodes)
