"""Encoding of a transition's source, and whether an episode moved its goal."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from iher_robot.learning.config import MOVED_M
from iher_robot.learning.episode import Episode
from iher_robot.learning.goal_model import IMAGINED, REAL, moved_goal, source_features
from tests.learning.point_mass import PointMassGoals


def test_env_is_real_is_one_for_real_and_zero_for_imagined() -> None:
    features = source_features(torch.tensor([REAL, IMAGINED, IMAGINED, REAL]))
    assert features.tolist() == [[1.0], [0.0], [0.0], [1.0]]


@pytest.mark.parametrize(
    ("way_m", "moved"), [(0.0, False), (0.99 * MOVED_M, False), (1.01 * MOVED_M, True), (-1, True)]
)
@pytest.mark.parametrize("returns", [False, True])
def test_a_goal_moved_if_it_was_ever_farther_than_the_threshold(
    way_m: float, moved: bool, returns: bool
) -> None:
    observations = np.full((6, 6), 0.3, dtype=np.float32)
    observations[3 : 4 if returns else 6, 1] += way_m
    actions = np.zeros((5, 2), dtype=np.float32)
    episode = Episode(observations, actions, actions, np.ones(5, dtype=bool), np.zeros(2))
    assert moved_goal(PointMassGoals(), episode) == moved
    assert moved_goal(PointMassGoals(), episode, 2.0) is False
