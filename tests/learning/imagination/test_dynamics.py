"""The dynamics ensemble: accuracy, weights of its data, differences between members."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Literal

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from iher_robot.learning.config import DynamicsConfig
from iher_robot.learning.imagination.dynamics import DynamicsEnsemble, recency_weights
from iher_robot.learning.replay import EpisodeReplay
from tests.learning.fakes import (
    CPU,
    FarAwaySymmetry,
    drifting_ensemble,
    generator,
    marked_episode,
    replay_of,
    store,
    stored,
)
from tests.learning.point_mass import SHAPES, rollout

Form = Literal["one-plus", "printed"]


def untrained(members: int = 3, seed: int = 0, **settings: float | str) -> DynamicsEnsemble:
    config = DynamicsConfig.model_validate({"members": members, "hidden": (64, 64)} | settings)
    return DynamicsEnsemble(SHAPES, config, generator=generator(seed), device=CPU)


def real_replay(episodes: int, seed: int = 0) -> EpisodeReplay:
    rng = np.random.default_rng(seed)
    return replay_of([rollout(rng) for _ in range(episodes)])


@pytest.fixture(scope="module")
def trained() -> DynamicsEnsemble:
    ensemble, replay = untrained(), real_replay(30)
    ensemble.fit_normalizers(replay, generator())
    ensemble.train(replay, 400, batch_size=64, generator=generator())
    return ensemble


@settings(deadline=None)
@given(st.integers(1, 300), st.floats(1, 20))
def test_recency_weights_are_the_closed_forms(epoch: int, bias: float) -> None:
    one_plus = recency_weights(epoch, DynamicsConfig(recency_bias=bias))
    printed = recency_weights(
        epoch, DynamicsConfig(recency_bias=bias + 1e-3, recency_weights="printed")
    )
    assert len(one_plus) == len(printed) == epoch + 1
    for i in range(epoch + 1):
        assert one_plus[i] == pytest.approx(1 + (bias - 1) * i / epoch)
        assert printed[i] == pytest.approx(i / epoch * (bias + 1e-3 - 1))


@pytest.mark.parametrize("bias", [1.0, 2.0, 5.0])
def test_the_newest_transitions_become_b_times_as_likely_as_the_first(bias: float) -> None:
    ratios = []
    for epoch in (2, 20, 2000):
        weights = recency_weights(epoch, DynamicsConfig(recency_bias=bias))
        ratios.append(float(weights[-1] / weights[1]))
    assert ratios == sorted(ratios)
    assert ratios[-1] == pytest.approx(bias, rel=0.01)


@pytest.mark.parametrize(
    ("form", "bias", "newest"),
    [
        ("one-plus", 1.0, 1 / 2),
        ("one-plus", 5.0, 5 / 7),
        ("printed", 5.0, 4 / 5),
        ("printed", 2.0, 4 / 5),
    ],
)
def test_training_weighs_transitions_by_their_epoch(form: Form, bias: float, newest: float) -> None:
    # One input with two outcomes, no change in epoch 1 and a drift of 1 in epoch 4: what the
    # model predicts is the share of draws from epoch 4.
    replay = replay_of()
    for epoch, drift in ((1, 0.0), (4, 1.0)):
        episode = marked_episode(0, 1)
        episode.observations[:, :] = 0.0
        episode.observations[1, 2] = drift
        store(replay, [episode] * 4, epoch)
    ensemble = untrained(2, recency_bias=bias, recency_weights=form, lr=3e-3)
    ensemble.fit_normalizers(replay, generator())
    ensemble.train(replay, 150, batch_size=1024, generator=generator())
    zero = torch.zeros(1, SHAPES.obs_dim), torch.zeros(1, SHAPES.action_dim)
    for prediction in ensemble.predict(*zero):
        assert ensemble.next_observation(zero[0], prediction)[0, 2] == pytest.approx(
            newest, abs=0.03
        )


def test_every_member_beats_no_change_and_the_mean_change_on_held_out_data(
    trained: DynamicsEnsemble,
) -> None:
    observation, action, following = stored(real_replay(40, seed=1))
    delta = following - observation
    no_change = delta.square().mean(0)
    mean_change = (delta - delta.mean(0)).square().mean(0)
    for prediction in trained.predict(observation, action):
        error = (trained.next_observation(observation, prediction) - following).square().mean(0)
        assert (error < 0.05 * no_change).all()
        assert (error < 0.05 * mean_change).all()


def test_training_reports_the_mean_squared_error_in_normalised_units(
    trained: DynamicsEnsemble,
) -> None:
    replay = real_replay(30)
    before = untrained()
    before.fit_normalizers(replay, generator())
    observation, action, following = stored(replay)
    target = before.delta_normalizer.normalize(following - observation)
    expected = float((before.predict(observation, action) - target).square().mean())
    reported = before.train(replay, 1, batch_size=20_000, generator=generator())
    assert reported == pytest.approx(expected, rel=0.02)
    assert trained.train(replay, 1, batch_size=2000, generator=generator()) < 0.02 * reported


def test_members_have_different_initial_weights() -> None:
    observation, action, _ = stored(real_replay(2))
    predictions = untrained(5).predict(observation, action)
    for one, other in itertools.combinations(predictions, 2):
        assert (one - other).abs().mean() > 0.01


def test_members_are_trained_on_different_batches() -> None:
    replay = real_replay(5)
    ensemble = drifting_ensemble(0.0, 0.0, 0.0)  # equal: only batches can make them differ
    ensemble.fit_normalizers(replay, generator())
    ensemble.train(replay, 20, batch_size=8, generator=generator())
    observation, action, _ = stored(replay)
    for one, other in itertools.combinations(ensemble.predict(observation, action), 2):
        assert (one - other).abs().mean() > 1e-4


def test_statistics_are_those_of_every_stored_transition() -> None:
    replay = real_replay(6)
    ensemble = untrained()
    ensemble.fit_normalizers(replay, generator())
    observation, action, following = (x.double().numpy() for x in stored(replay))
    inputs, delta = np.concatenate([observation, action], axis=-1), following - observation
    for normalizer, values in (
        (ensemble.input_normalizer, inputs),
        (ensemble.delta_normalizer, delta),
    ):
        np.testing.assert_allclose(normalizer.mean, values.mean(0), atol=1e-6)
        np.testing.assert_allclose(normalizer.std, values.std(0), rtol=1e-4)
    every = np.concatenate([observation, following])
    np.testing.assert_array_equal(ensemble.obs_low, every.min(0))
    np.testing.assert_array_equal(ensemble.obs_high, every.max(0))


def test_statistics_do_not_change_until_the_next_fit() -> None:
    replay = real_replay(4)
    ensemble = untrained()
    ensemble.fit_normalizers(replay, generator())
    normalizers = ensemble.input_normalizer, ensemble.delta_normalizer
    fitted = [normalizer.state_dict() for normalizer in normalizers]
    store(replay, [marked_episode(50, SHAPES.episode_ticks)])
    ensemble.train(replay, 3, batch_size=16, generator=generator())
    for normalizer, before in zip(normalizers, fitted, strict=True):
        assert torch.equal(normalizer.mean, before["mean"])
        assert torch.equal(normalizer.std, before["std"])
    ensemble.fit_normalizers(replay, generator())
    for normalizer, before in zip(normalizers, fitted, strict=True):
        assert not torch.equal(normalizer.mean, before["mean"])


def test_an_entry_that_never_changes_is_normalised_with_the_floor() -> None:
    replay = replay_of([marked_episode(3, SHAPES.episode_ticks)])  # most entries are constant
    ensemble = untrained(std_floor=0.02)
    ensemble.fit_normalizers(replay, generator())
    assert ensemble.delta_normalizer.std.tolist() == pytest.approx([0.02] * SHAPES.obs_dim)
    ensemble.train(replay, 5, batch_size=16, generator=generator())
    observation, action, _ = stored(replay)
    assert ensemble.predict(observation, action).isfinite().all()


def test_a_restored_ensemble_trains_like_the_original(trained: DynamicsEnsemble) -> None:
    replay = real_replay(3)
    copies = untrained(seed=8), untrained(seed=9)
    state = trained.state_dict()
    for copy in copies:
        copy.load_state_dict(state)
        copy.fit_normalizers(replay, generator())
        copy.train(replay, 3, batch_size=16, generator=generator(4))
    observation, action, _ = stored(replay)
    one, other = (copy.predict(observation, action) for copy in copies)
    assert torch.equal(one, other)
    assert not torch.equal(one, trained.predict(observation, action))
    untouched = untrained(seed=8)
    untouched.load_state_dict(state)  # no copy has written to the state that it loaded
    assert torch.equal(untouched.predict(observation, action), trained.predict(observation, action))
    assert torch.equal(untouched.obs_low, trained.obs_low)
    assert torch.equal(untouched.obs_high, trained.obs_high)


def test_with_a_symmetry_statistics_and_training_are_those_of_images() -> None:
    replay = real_replay(20)
    config = DynamicsConfig(members=2, hidden=(64, 64))
    ensemble = DynamicsEnsemble(
        SHAPES, config, generator=generator(), device=CPU, symmetry=FarAwaySymmetry()
    )
    ensemble.fit_normalizers(replay, generator())
    observation, action, following = stored(replay)
    assert ((ensemble.obs_low[:2] > 99) & (ensemble.obs_high[:2] > 190)).all()
    mean = ensemble.input_normalizer.mean
    assert mean[:2].tolist() == pytest.approx([150.0, 150.0], abs=15)
    torch.testing.assert_close(mean[-2:], -action.mean(0))
    # Images have reversed actions, so that their models see opposite motions.
    ensemble.train(replay, 300, batch_size=64, generator=generator())
    observation = observation + torch.tensor([150.0, 150.0, 0, 0, 0, 0])
    velocity = following[:, 2:4]
    for prediction in ensemble.predict(observation, -action):
        error = ensemble.next_observation(observation, prediction)[:, 2:4] - velocity
        assert error.square().mean() < 0.05 * velocity.square().mean()


def test_training_on_values_that_are_not_finite_fails_and_names_the_remedy() -> None:
    replay = real_replay(2)
    ensemble = drifting_ensemble(float("nan"), 0.0)
    with pytest.raises(FloatingPointError, match=r"diverged; lower learner\.dynamics\.lr"):
        ensemble.train(replay, 1, batch_size=8, generator=generator())


def test_relative_models_are_invariant_to_a_shift_of_the_scene() -> None:
    shapes = dataclasses.replace(SHAPES, shifted_entries=(0, 1))
    config = DynamicsConfig(hidden=(16,), inputs="relative")
    ensemble = DynamicsEnsemble(shapes, config, generator=generator(), device=CPU)
    replay = real_replay(5)
    ensemble.fit_normalizers(replay, generator())
    ensemble.train(replay, 5, batch_size=16, generator=generator())
    observation, action, _ = stored(replay)
    elsewhere = observation + torch.tensor([3.0, -2.0, 0, 0, 0, 0])
    assert torch.equal(ensemble.predict(elsewhere, action), ensemble.predict(observation, action))
    faster = observation + torch.tensor([0, 0, 0.1, 0, 0, 0])
    assert not torch.allclose(
        ensemble.predict(faster, action), ensemble.predict(observation, action)
    )
