"""Conversion of stored episodes to episodes of Minari.

A Minari episode is a maximal run of valid ticks of a stored episode, so that no transition spans
an invalid one. Observations are those of `GoalRobotEnv`, actions the applied ones, rewards the
task's own. No step is terminal; the last one is truncated. Infos have one entry more than there
are steps, as always in Minari; the first belongs to the initial observation:

- ``is_success``: Whether the observation is at the goal.
- ``action_requested``: The action requested in the step before; NaN in the first entry.
- ``tick``: Ticks of the stored episode before the observation.
- ``seq``: The robot's tick counter at the observation.

The metadata of an episode hold ``run``, ``stored_episode``, ``epoch``, ``account``,
``told_source`` and ``ended`` of the stored one, and its ``seed`` if it begins with a reset.
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
    """Cuts stored episodes into episodes of Minari.

    Attributes:
        metadata: Metadata of each Minari episode so far.
        left_out_ticks: Ticks so far that are in no Minari episode.
    """

    def __init__(self, model: GoalModel) -> None:
        self._model = model
        self.metadata: list[dict[str, Any]] = []
        self.left_out_ticks = 0

    def buffers(self, episodes: Iterator[tuple[str, StoredEpisode]]) -> Iterator[EpisodeBuffer]:
        """Cut stored episodes, each given with the name of its run."""
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
                # A valid tick directly follows the one before it, whose counter was one less.
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
