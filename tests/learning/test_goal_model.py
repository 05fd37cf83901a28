"""Encoding of a transition's source as a network input."""

from __future__ import annotations

import torch

from iher_robot.learning.goal_model import IMAGINED, REAL, source_features


def test_env_is_real_is_one_for_real_and_zero_for_imagined() -> None:
    features = source_features(torch.tensor([REAL, IMAGINED, IMAGINED, REAL]))
    assert features.tolist() == [[1.0], [0.0], [0.0], [1.0]]
