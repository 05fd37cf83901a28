"""Evaluation episodes: no noise, success at the last step."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from iher_robot.collect import Recorder
from iher_robot.learning.episode import Episode


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
