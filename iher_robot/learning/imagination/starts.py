"""Start states and goals of imagined rollouts."""

from __future__ import annotations

import numpy as np
import torch

from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.goal_model import GoalModel
from iher_robot.learning.replay import EpisodeReplay
from iher_robot.learning.symmetry import Symmetry, augment, choose_maps


class StartStates:
    """Draws where imagined rollouts begin, and their goals.

    Whole episodes begin at the first observation of a real episode, with a goal of the task;
    branches begin at any real state, with a goal of its episode, relabelled or not.

    Args:
        real: Real episodes.
        goal_model: Goals of the task.
        config: Branches or whole episodes; relabelling.
        generator: Source of randomness, on the data's device.
        symmetry: Maps to whose images starts are moved; None for none.
    """

    def __init__(
        self,
        real: EpisodeReplay,
        goal_model: GoalModel,
        config: LearnerConfig,
        *,
        generator: torch.Generator,
        symmetry: Symmetry | None,
    ) -> None:
        self._real = real
        self._goal_model = goal_model
        self._branches = config.imagination.branch_ticks is not None
        self._future_fraction = config.replay.future_fraction
        self._generator = generator
        self._symmetry = symmetry

    def draw(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw first observations and goals. ``(count, obs_dim)``, ``(count, goal_dim)``"""
        return self._of_branches(count) if self._branches else self._of_episodes(count)

    def _of_branches(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        drawn = self._real.sample(
            count, self._generator, self._goal_model, future_fraction=self._future_fraction
        )
        drawn = augment(drawn, self._symmetry, self._generator)
        return drawn.observation, drawn.goal

    def _of_episodes(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        starts = self._real.start_observations()
        row = torch.randint(len(starts), (count,), generator=self._generator, device=starts.device)
        start = starts[row]
        if self._symmetry is not None:
            start = choose_maps(self._symmetry, start, start, self._generator).observation(start)
        return start, self._sample_goals(start)

    def _sample_goals(self, start: torch.Tensor) -> torch.Tensor:
        # The task draws with NumPy, seeded with a number of the learner's stream.
        seed = int(torch.randint(2**62, (), generator=self._generator, device=start.device))
        goals = self._goal_model.sample_goal(np.random.default_rng(seed), start.cpu().numpy())
        return torch.as_tensor(goals, dtype=torch.float32, device=start.device)
