"""Interface between task and learner: goals, rewards, array shapes and sources."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from iher_robot.learning.config import MOVED_M
from iher_robot.learning.episode import Episode

Array = NDArray[np.floating]


class GoalModel(Protocol):
    """Pure functions of a goal-conditioned task, batched over leading axes.

    The learner calls them on imagined observations, which are tensors on its device.
    """

    def achieved_goal(self, observation: torch.Tensor, /) -> torch.Tensor:
        """Goal that an observation achieves. ``(..., obs_dim) -> (..., goal_dim)``"""

    def compute_reward(self, achieved: torch.Tensor, desired: torch.Tensor, /) -> torch.Tensor:
        """Sparse reward: 0 where the goal is met, else -1. ``(..., goal_dim) -> (...,)``"""

    def tightened(self, share: float, /) -> GoalModel:
        """The same goals, met only within this share of the tolerance."""

    def complete(self, observation: torch.Tensor, /) -> torch.Tensor:
        """Observation with its derived entries recomputed. ``(..., obs_dim)``"""

    def sample_goal(self, rng: np.random.Generator, start_observation: Array, /) -> Array:
        """Goals for episodes with these starts. ``(batch, obs_dim) -> (batch, goal_dim)``"""


def moved_goal(model: GoalModel, episode: Episode, threshold_m: float = MOVED_M) -> bool:
    """Whether the achieved goal was ever farther from its start than the threshold."""
    achieved = model.achieved_goal(torch.as_tensor(episode.observations))
    displacement = torch.linalg.vector_norm(achieved - achieved[0], dim=-1).amax()
    return bool(displacement > threshold_m)


@dataclass(frozen=True)
class Shapes:
    """Sizes of the learner's arrays, and entries of an observation with a special meaning.

    Attributes:
        obs_dim: Length of an observation.
        goal_dim: Length of a goal.
        action_dim: Length of an action.
        episode_ticks: Ticks of an episode.
        goal_entries: Entries of the observation that hold the achieved goal, in the goal's order;
            empty where the achieved goal is not part of the observation.
        shifted_entries: Entries of the observation that a shift of the whole scene changes; the
            task declares that dynamics and reward do not depend on such a shift.
    """

    obs_dim: int
    goal_dim: int
    action_dim: int
    episode_ticks: int
    goal_entries: tuple[int, ...] = ()
    shifted_entries: tuple[int, ...] = ()


REAL = 0
"""Index of the real source."""
IMAGINED = 1
"""Index of the imagined source."""
SOURCES = ("real", "imagined")
"""Names of the sources, by index."""


def source_features(source: torch.Tensor) -> torch.Tensor:
    """Encode source indices for actor and critic.

    One-hot over the sources without the imagined one, so that with the paper's two sources it
    is ``env_is_real``: 1 for real, 0 for imagined (paper, section III.E).

    Args:
        source: Indices into ``SOURCES``. ``(...,)``

    Returns:
        Features. ``(..., len(SOURCES) - 1)``
    """
    others = [index for index in range(len(SOURCES)) if index != IMAGINED]
    return torch.stack([(source == index).float() for index in others], dim=-1)
