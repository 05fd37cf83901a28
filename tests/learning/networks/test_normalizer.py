"""Normalisers against NumPy."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from iher_robot.learning.networks.normalizer import BLOCK, FittedNormalizer, RunningNormalizer
from tests.learning.fakes import CPU, generator


def running(clip: float = 5.0, std_floor: float = 0.01) -> RunningNormalizer:
    return RunningNormalizer(3, clip=clip, std_floor=std_floor, device=CPU)


@settings(deadline=None, max_examples=50)
@given(
    st.lists(st.integers(1, 40), min_size=1, max_size=6),
    st.floats(-50, 50),
    st.floats(0.05, 100),
    st.integers(0, 2**31),
)
def test_running_statistics_are_those_of_all_batches_together(
    sizes: list[int], offset: float, spread: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    batches = [rng.normal(offset, spread, size=(size, 3)) for size in sizes]
    normalizer = running(std_floor=1e-6)
    for batch in batches:
        normalizer.update(torch.as_tensor(batch))
    everything = np.concatenate(batches)
    std = np.maximum(everything.std(axis=0), 1e-6)
    np.testing.assert_allclose(normalizer.mean, everything.mean(axis=0), rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(normalizer.std, std, rtol=1e-3, atol=2e-6)


def test_a_spread_of_a_millimetre_around_a_metre_keeps_its_variance() -> None:
    values = np.random.default_rng(0).normal(1.3, 1e-3, size=(100_000, 3))
    normalizer = running(std_floor=1e-6)
    for batch in np.array_split(values, 50):
        normalizer.update(torch.as_tensor(batch))
    np.testing.assert_allclose(normalizer.std, values.std(axis=0), rtol=1e-4)


def test_before_any_data_values_pass_unchanged() -> None:
    values = torch.tensor([[0.5, -2.0, 3.0]])
    assert torch.equal(running()(values), values)


def test_normalised_values_are_clipped_and_the_deviation_floored() -> None:
    normalizer = running(clip=2.0, std_floor=0.1)
    normalizer.update(torch.ones(10, 3))  # no spread at all
    assert normalizer.std.tolist() == pytest.approx([0.1] * 3)
    values = torch.tensor([[1.05, 1.9, -50.0]])
    np.testing.assert_allclose(normalizer(values), [[0.5, 2.0, -2.0]], rtol=1e-5)


def test_a_restored_normaliser_is_independent_of_the_original() -> None:
    rng = np.random.default_rng(0)
    first, second = torch.as_tensor(rng.normal(2, 3, (2, 20, 3)))
    original = running()
    original.update(first)
    state = original.state_dict()
    kept = {name: value.clone() for name, value in state.items()}
    copies = running(), running()
    for copy in copies:
        copy.load_state_dict(state)
        copy.update(second)
    for name, value in kept.items():  # neither the original nor the state has moved
        assert torch.equal(state[name], value), name
        assert torch.equal(original.state_dict()[name], value), name
    original.update(second)
    for copy in copies:
        assert torch.equal(copy.mean, original.mean)
        assert torch.equal(copy.std, original.std)


@settings(deadline=None, max_examples=30)
@given(st.floats(-50, 50), st.floats(0.05, 100), st.integers(0, 2**31))
def test_fitted_values_have_mean_zero_and_unit_spread_and_denormalise(
    offset: float, spread: float, seed: int
) -> None:
    values = torch.as_tensor(np.random.default_rng(seed).normal(offset, spread, (60, 3))).float()
    normalizer = FittedNormalizer(3, std_floor=1e-3, device=CPU)
    normalizer.fit(torch.randn(9, 3))
    normalizer.fit(values)  # replaces, and does not add to, the first fit
    normal = normalizer.normalize(values)
    np.testing.assert_allclose(normal.mean(0), 0.0, atol=1e-3)
    np.testing.assert_allclose(normal.std(0, correction=0), 1.0, rtol=1e-3)
    np.testing.assert_allclose(normalizer.denormalize(normal), values, rtol=1e-3, atol=1e-3)


def test_a_constant_entry_is_divided_by_the_floor() -> None:
    normalizer = FittedNormalizer(2, std_floor=0.01, device=CPU)
    normalizer.fit(torch.tensor([[1.0, 0.0], [1.0, 4.0]]))
    assert normalizer.std.tolist() == pytest.approx([0.01, 2.0])
    np.testing.assert_allclose(
        normalizer.normalize(torch.tensor([1.02, 2.0])), [2.0, 0.0], atol=1e-4
    )
    copy = FittedNormalizer(2, std_floor=0.01, device=CPU)
    copy.load_state_dict(normalizer.state_dict())
    assert torch.equal(copy.mean, normalizer.mean)
    assert torch.equal(copy.std, normalizer.std)


def test_more_values_than_a_block_are_fitted_as_all_at_once() -> None:
    values = 100.0 + torch.randn(2 * BLOCK + 5, 3, generator=generator())
    values[:BLOCK] += 1.0  # blocks have different means
    normalizer = FittedNormalizer(3, std_floor=1e-3, device=CPU)
    normalizer.fit(values)
    assert torch.equal(normalizer.mean, values.double().mean(0).float())
    torch.testing.assert_close(normalizer.std, values.double().std(0, correction=0).float())
