"""Diagnostics of models that are perfect or predict no change."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from iher_robot.learning.diagnostics import HORIZONS, diagnose, imagined_success, open_loop_error
from iher_robot.learning.episode import Episode
from iher_robot.learning.imagination.dynamics import DynamicsEnsemble
from iher_robot.learning.learner import Learner
from tests.learning.fakes import (
    CPU,
    drifting_ensemble,
    generator,
    linear_policy,
    perfect_ensemble,
    quiet_config,
)
from tests.learning.point_mass import SHAPES, PointMassGoals, rollout

GOALS = PointMassGoals()


def episodes(count: int = 20, seed: int = 0, **policy: Any) -> list[Episode]:
    rng = np.random.default_rng(seed)
    actor = linear_policy(**policy) if policy else None
    return [rollout(rng, actor) for _ in range(count)]


def error(ensemble: DynamicsEnsemble, real: list[Episode], horizon: int) -> tuple[float, float]:
    return open_loop_error(ensemble, GOALS, real, horizon, state_margin=0.1, generator=generator())


def displacement(real: list[Episode], horizon: int) -> float:
    """Mean distance over every window, in NumPy."""
    distances = [
        np.linalg.norm(e.observations[t + horizon, :2] - e.observations[t, :2])
        for e in real
        for t in range(len(e) - horizon + 1)
    ]
    return float(np.mean(distances))


@pytest.mark.parametrize("horizon", [1, 5, SHAPES.episode_ticks])
def test_a_perfect_model_has_no_error_and_no_change_errs_by_the_displacement(horizon: int) -> None:
    real = episodes()
    model, still = error(perfect_ensemble(), real, horizon)
    assert model == pytest.approx(0, abs=1e-5)
    assert still == pytest.approx(displacement(real, horizon), rel=1e-4)
    assert still > 0.02


@pytest.mark.parametrize("horizon", [1, 10])
def test_a_model_of_no_change_errs_like_predicting_no_change(horizon: int) -> None:
    model, still = error(drifting_ensemble(0.0), episodes(), horizon)
    assert model == pytest.approx(still, rel=1e-5)


def test_a_window_never_spans_an_invalid_tick() -> None:
    def jump(episode: Episode) -> Episode:
        observations, valid = episode.observations.copy(), episode.valid.copy()
        observations[6:, :2] += 5.0  # in tick 5, which is not valid
        valid[5] = False
        return replace(episode, observations=observations, valid=valid)

    jumped = [jump(e) for e in episodes()]
    model, still = error(perfect_ensemble(), jumped, 4)
    assert model == pytest.approx(0, abs=1e-5)
    assert still < 1


def test_windows_can_be_limited_to_those_that_move_the_achieved_goal() -> None:
    real = episodes()
    for episode in real:
        episode.observations[6:, :2] = episode.observations[5, :2]  # no motion after tick 5
    distances = [
        float(np.linalg.norm(e.observations[t + 1, :2] - e.observations[t, :2]))
        for e in real
        for t in range(len(e))
    ]
    moving = [distance for distance in distances if distance >= 0.01]
    assert 0 < len(moving) < 0.5 * len(distances)
    ensemble = drifting_ensemble(0.0)
    for least, expected in ((0.0, distances), (0.01, moving)):
        _, still = open_loop_error(
            ensemble,
            GOALS,
            real,
            1,
            state_margin=0.1,
            generator=generator(),
            least_motion=least,
        )
        assert still == pytest.approx(np.mean(expected), rel=1e-4)
    none = open_loop_error(
        ensemble, GOALS, real, 1, state_margin=0.1, generator=generator(), least_motion=1.0
    )
    assert all(map(math.isnan, none))


def test_the_error_is_nan_without_an_episode_of_that_length() -> None:
    assert all(map(math.isnan, error(perfect_ensemble(), episodes(), SHAPES.episode_ticks + 1)))


def learner(ensemble: DynamicsEnsemble, *, source_input: bool, **policy: Any) -> Learner:
    """A learner whose model and policy are given."""
    config = quiet_config(
        ddpg={"hidden": (), "source_input": source_input},
        dynamics={"hidden": (), "members": len(ensemble.members)},
        replay={"normalizer_clip": 1e9},
    )
    learner = Learner(SHAPES, GOALS, config, seed=0, device=CPU)
    learner.ensemble.load_state_dict(ensemble.state_dict())
    learner.policy.load_snapshot(linear_policy(**policy).snapshot())
    return learner


@pytest.mark.parametrize(("gain", "low", "high"), [(0.0, 0, 0.2), (2.5, 0.2, 0.8), (5.0, 1, 1)])
def test_imagined_success_is_the_real_one_if_the_model_is_perfect(
    gain: float, low: float, high: float
) -> None:
    real = episodes(100, goal_gain=gain)
    met = [GOALS.compute_reward(e.observations[-1, :2], e.desired_goal) == 0 for e in real]
    assert low <= np.mean(met) <= high
    dreamer = learner(perfect_ensemble(), source_input=False, goal_gain=gain)
    assert imagined_success(dreamer, real, generator=generator()) == pytest.approx(np.mean(met))


def test_the_policy_acts_with_the_imagined_source() -> None:
    # Reaches the goal unless its source input is the real one.
    dreamer = learner(perfect_ensemble(), source_input=True, goal_gain=5.0, real_bias=50.0)
    assert imagined_success(dreamer, episodes(50), generator=generator()) == 1.0


def test_a_rollout_that_diverges_is_a_failure() -> None:
    dreamer = learner(drifting_ensemble(float("nan")), source_input=False, goal_gain=5.0)
    assert imagined_success(dreamer, episodes(5), generator=generator()) == 0.0


def test_a_diagnosis_has_every_horizon_and_draws_nothing_from_the_learner() -> None:
    dreamer = learner(perfect_ensemble(), source_input=False, goal_gain=5.0)
    before = dreamer.generator.get_state()
    real = episodes(30, goal_gain=5.0)
    report = diagnose(dreamer, real)
    assert torch.equal(dreamer.generator.get_state(), before)
    assert set(report) == {"imagined_success"} | {
        f"{kind}_error_{case}" for kind in ("model", "still") for case in (*HORIZONS, "contact")
    }
    assert HORIZONS == (1, 10, 50)
    for horizon in (1, 10):
        assert report[f"model_error_{horizon}"] == pytest.approx(0, abs=1e-5)
        assert report[f"still_error_{horizon}"] == pytest.approx(
            displacement(real, horizon), rel=1e-4
        )
    assert math.isnan(report["model_error_50"])  # the point mass's episodes have 12 ticks
    assert report["imagined_success"] == 1.0
    assert diagnose(dreamer, []) == {}


def test_without_imagination_a_diagnosis_is_empty() -> None:
    config = quiet_config(imagination={"enabled": False})
    assert diagnose(Learner(SHAPES, GOALS, config, seed=0, device=CPU), episodes(2)) == {}
