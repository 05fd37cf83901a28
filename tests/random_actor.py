"""An actor of random actions, for episodes whose motion does not matter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from iher_robot.learning.goal_model import REAL


class RandomActor:
    """Draws every action from [-1, 1]; one seed for all episodes."""

    def __init__(self, seed: int, action_dim: int = 4) -> None:
        self._rng = np.random.default_rng(seed)
        self._action_dim = action_dim
        self.policy_source = REAL

    def begin(self, seed: int) -> None:
        """Continue the same sequence of draws."""

    def act(self, observation: object) -> NDArray[np.float32]:
        """Draw an action. ``(action_dim,)``"""
        return self._rng.uniform(-1, 1, self._action_dim).astype(np.float32)
