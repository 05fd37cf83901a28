"""Success rate: evaluation episodes without noise, judged at their last step."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import torch

from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.learning.diagnostics import diagnose
from iher_robot.learning.episode import Episode
from iher_robot.learning.learner import Learner
from iher_robot.learning.progress import Progress
from iher_robot.rollout.actor import PolicyActor
from iher_robot.rollout.episode import Stream, episode_seed, run_episode
from iher_robot.rollout.recorder import Recorder


class Outcome(Protocol):
    """Outcome of an episode."""

    @property
    def success(self) -> bool:
        """Whether the last step met the goal."""

    @property
    def aborted(self) -> str:
        """Why it could not go on, empty if it could."""

    @property
    def ticks(self) -> int:
        """Control ticks charged."""

    def episode(self) -> Episode | None:
        """The ticks recorded whole; None before the first."""


RunSeeds = Callable[[Learner, Sequence[int]], Iterator[Outcome]]
"""Runs the episode of each seed in turn, without noise, as the learner is now."""


@dataclass(frozen=True)
class Evaluation:
    """Successes and data of evaluated episodes.

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
    outcomes: Iterable[Outcome],
    on_episode: Callable[[int], None] | None = None,
) -> Evaluation:
    """Add up the outcomes of episodes.

    Args:
        outcomes: The outcomes; each episode runs when it is iterated.
        on_episode: Called with the number of episodes done.

    Returns:
        Successes and the episodes.
    """
    recorded: list[Episode] = []
    successes = count = 0
    for outcome in outcomes:
        count += 1
        successes += outcome.success
        episode = outcome.episode()
        if episode is not None:
            recorded.append(episode)
        if on_episode is not None:
            on_episode(count)
    return Evaluation(successes, count, recorded)


def run_simulated(
    simulator: GoalRobotEnv, learner: Learner, seeds: Sequence[int]
) -> Iterator[Recorder]:
    """Run episodes in one simulator, neither charged nor stored.

    Args:
        simulator: The simulator.
        learner: Acts as it is now.
        seeds: Decide starts and goals.
    """
    actor = PolicyActor(learner.acting_policy(torch.device("cpu")))
    for seed in seeds:
        recorder = Recorder()
        run_episode(simulator, actor, recorder, seed=seed, ticks=simulator.task.episode_ticks)
        yield recorder


def evaluate_learner(
    learner: Learner,
    run_seeds: RunSeeds,
    *,
    run_seed: int,
    count: int,
    progress: Progress,
) -> dict[str, float]:
    """Evaluate the success rate, and the models' errors on the same episodes.

    Args:
        learner: The learner after the epoch.
        run_seeds: Runs the episodes.
        run_seed: Seed of the run.
        count: Episodes to run.
        progress: Called with the number of episodes done.

    Returns:
        Metrics.
    """
    # Numbers that follow from the epoch, so that a resumed run draws the same episodes.
    first = learner.epoch * count
    seeds = [episode_seed(run_seed, Stream.EVALUATION, first + i) for i in range(count)]
    evaluation = run_evaluation(
        run_seeds(learner, seeds), lambda done: progress("evaluate", done, count)
    )
    return {"success": evaluation.success_rate} | diagnose(learner, evaluation.episodes)
