"""Curiosity: clip(nu sigma, 0, eta)."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from iher_robot.learning.config import IntrinsicConfig
from iher_robot.learning.imagination import intrinsic
from iher_robot.learning.imagination.intrinsic import (
    disagreement,
    intrinsic_reward,
    refresh_intrinsic,
)
from tests.learning.fakes import generator, linear_ensemble, marked_episode, replay_of
from tests.learning.point_mass import PointMassGoals


@settings(deadline=None)
@given(st.integers(1, 6), st.integers(1, 5), st.integers(0, 2**31))
def test_disagreement_is_the_population_variance_over_members(
    members: int, batch: int, seed: int
) -> None:
    predictions = np.random.default_rng(seed).normal(size=(members, batch, 6)).astype(np.float32)
    variance = ((predictions - predictions.mean(0)) ** 2).mean(0)
    tensor = torch.as_tensor(predictions)
    np.testing.assert_allclose(
        disagreement(tensor, IntrinsicConfig(reduce="mean")), variance.mean(-1), atol=1e-5
    )
    np.testing.assert_allclose(
        disagreement(tensor, IntrinsicConfig(reduce="sum")), variance.sum(-1), atol=1e-5
    )


@settings(deadline=None)
@given(st.floats(0, 100), st.floats(0, 5), st.floats(0.01, 3))
def test_the_reward_is_scaled_and_clipped(sigma: float, scale: float, clip: float) -> None:
    reward = intrinsic_reward(torch.tensor([sigma]), IntrinsicConfig(scale=scale, clip=clip))
    assert float(reward) == pytest.approx(min(scale * sigma, clip), rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("chunk", [5, 7, 10_000])
def test_refreshing_writes_each_transitions_own_reward(
    chunk: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(intrinsic, "CHUNK", chunk)
    # Two members that differ by 2 x (episode number) in one entry: sigma is number^2 / 6.
    weight = torch.zeros(6, 8)
    weight[2, 0] = 1.0
    ensemble = linear_ensemble([[0.0] * 6] * 2, weight)
    state = ensemble.state_dict()
    state["members"]["1.0.weight"] = -weight
    ensemble.load_state_dict(state)
    replay = replay_of([marked_episode(n, length) for n, length in enumerate([3, 12, 1, 9])])
    returned = refresh_intrinsic(replay, ensemble, IntrinsicConfig(scale=0.6, clip=0.5))
    batch = replay.sample(500, generator(), PointMassGoals(), future_fraction=0.8)
    expected = (0.1 * batch.observation[:, 0] ** 2).clamp(max=0.5)
    torch.testing.assert_close(batch.intrinsic, expected)
    assert len(set(batch.intrinsic.tolist())) == 4
    numbers = torch.tensor([0.0] * 3 + [1.0] * 12 + [2.0] + [3.0] * 9)
    torch.testing.assert_close(returned, (0.1 * numbers**2).clamp(max=0.5))
