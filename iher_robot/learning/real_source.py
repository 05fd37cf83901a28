"""The real source: episodes of the robot, as the learner stores and samples them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import torch

from iher_robot.learning.config import ReplayConfig
from iher_robot.learning.episode import Episode
from iher_robot.learning.goal_model import REAL, GoalModel, Shapes, moved_goal
from iher_robot.learning.replay import EpisodeReplay
from iher_robot.learning.symmetry import Symmetry, augment
from iher_robot.learning.transitions import Transitions


class RealSource:
    """Real episodes, split at invalid ticks.

    Args:
        shapes: Sizes of the arrays.
        goal_model: Achieved goals, and rewards of relabelled goals.
        config: Capacity, weights and relabelling.
        generator: Source of randomness, on ``device``.
        device: Where the data live.
        symmetry: Maps whose images are sampled; None for none.

    Attributes:
        replay: The stored episodes.
        collected: Valid ticks collected so far, stored or not.
        fresh: Valid ticks of the newest epoch.
    """

    def __init__(
        self,
        shapes: Shapes,
        goal_model: GoalModel,
        config: ReplayConfig,
        *,
        generator: torch.Generator,
        device: torch.device,
        symmetry: Symmetry | None = None,
    ) -> None:
        self.shapes = shapes
        self.goal_model = goal_model
        self.config = config
        self.generator = generator
        self.device = device
        self.symmetry = symmetry
        self.replay = self._new_replay(config.capacity)
        self.collected = 0
        self.fresh = 0

    def _new_replay(self, capacity: int) -> EpisodeReplay:
        return EpisodeReplay(
            self.shapes,
            capacity=capacity,
            source=REAL,
            device=self.device,
            between=self.config.actions == "between",
        )

    def clear(self) -> None:
        """Remove every episode and its count."""
        self.replay.clear()
        self.collected = 0

    def add(self, episodes: Iterable[Episode], *, epoch: int) -> list[Episode]:
        """Store the episodes of an epoch.

        Args:
            episodes: The epoch's episodes.
            epoch: Epoch in which they were collected, from 1.

        Returns:
            Their runs of valid ticks, which are what is stored.
        """
        segments = [segment for episode in episodes for segment in episode.segments()]
        self._store(segments, self.replay, epoch)
        self.fresh = sum(len(segment) for segment in segments)
        self.collected += self.fresh
        return segments

    def replay_of(self, segments: Sequence[Episode], *, epoch: int) -> EpisodeReplay:
        """Replay of these segments alone; there must be at least one."""
        replay = self._new_replay(len(segments) * self.shapes.episode_ticks)
        self._store(segments, replay, epoch)
        return replay

    def _store(self, segments: Sequence[Episode], replay: EpisodeReplay, epoch: int) -> None:
        def batch_of_one(array: object) -> torch.Tensor:
            return torch.as_tensor(array, device=self.device).unsqueeze(0)

        for segment in segments:
            moved = moved_goal(self.goal_model, segment, self.config.moved_m)
            replay.add(
                batch_of_one(segment.observations),
                batch_of_one(segment.actions),
                batch_of_one(segment.desired_goal),
                epoch=epoch,
                requested=batch_of_one(segment.requested_actions),
                weight=1.0 if moved else self.config.still_weight,
            )

    def sample(self, count: int, replay: EpisodeReplay | None = None) -> Transitions:
        """Sample relabelled transitions, or their images where a symmetry is used.

        Args:
            count: Transitions, drawn with replacement.
            replay: A part of the data, from ``replay_of``; None for all of them.
        """
        replay = self.replay if replay is None else replay
        batch = replay.sample(
            count, self.generator, self.goal_model, future_fraction=self.config.future_fraction
        )
        return augment(batch, self.symmetry, self.generator)
