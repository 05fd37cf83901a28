"""Stored episodes as Minari has them.

A Minari episode is a run of valid ticks of a stored one: where a tick is not valid it ends, and
the next one begins after it, so that no transition spans one. Observations are those of
`GoalRobotEnv`, actions those that were applied, rewards the task's own. Nothing ever terminates;
the last step is truncated. What Minari calls infos has, as always there, one entry more than there
are steps, the first of them for the observation that the episode begins with:

- ``is_success``: Whether the observation is at the goal.
- ``action_requested``: The action that was asked for in the step that led there; NaN at first.
- ``tick``: Ticks of the stored episode before the observation.
- ``seq``: The robot's own tick counter at the observation.

An episode's metadata say its ``run``, ``stored_episode``, ``epoch``, ``account``, ``told_source``
and how the stored one ``ended``; its ``seed`` is there where it begins with a reset.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from iher_robot.learning.episode import Episode
from iher_robot.storage.episode import StoredEpisode
from tasks import GoalModel

if TYPE_CHECKING:
    from minari.data_collector.episode_buffer import EpisodeBuffer


class MinariEpisodes:
    """Cuts stored episodes into those of Minari, one after the other.

    Attributes:
        metadata: Of each Minari episode so far.
        left_out_ticks: Ticks so far that are in none.
    """

    def __init__(self, model: GoalModel) -> None:
        self._model = model
        self.metadata: list[dict[str, Any]] = []
        self.left_out_ticks = 0

    def buffers(self, episodes: Iterator[tuple[str, StoredEpisode]]) -> Iterator[EpisodeBuffer]:
        """Cut all of them."""
        for name, stored in episodes:
            first, valid = 0, stored.episode.valid
            self.left_out_ticks += int((~valid).sum())
            for segment in stored.episode.segments():
                first += int(valid[first:].argmax())
                self.metadata.append(_episode_metadata(name, stored))
                yield self._buffer(stored, segment, first)
                first += len(segment)

    def _buffer(self, stored: StoredEpisode, segment: Episode, first: int) -> EpisodeBuffer:
        from minari.data_collector.episode_buffer import EpisodeBuffer

        length, goal = len(segment), segment.desired_goal
        achieved = self._model.achieved_goal(segment.observations)
        ticks = slice(first, first + length)
        seqs = stored.seqs[ticks]
        never = np.full((1, segment.actions.shape[1]), np.nan)
        return EpisodeBuffer(
            seed=stored.seed if first == 0 else None,
            observations={
                "observation": segment.observations,
                "achieved_goal": achieved,
                "desired_goal": np.tile(goal, (length + 1, 1)),
            },
            actions=segment.actions,
            rewards=self._model.compute_reward(achieved[1:], goal),
            terminations=np.zeros(length, bool),
            truncations=np.arange(length) == length - 1,
            infos={
                "is_success": self._model.is_success(achieved, goal),
                "action_requested": np.concatenate([never, segment.requested_actions]),
                "tick": np.arange(first, first + length + 1),
                # A valid tick follows the one before it, so that the counter was one less then.
                "seq": np.concatenate([seqs[:1] - 1, seqs]),
            },
        )


def _episode_metadata(name: str, stored: StoredEpisode) -> dict[str, Any]:
    return {
        "run": name,
        "stored_episode": stored.index,
        "epoch": stored.epoch,
        "account": stored.account,
        "told_source": stored.policy_source,
        "ended": stored.ended,
    }
