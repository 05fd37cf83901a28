"""Imagined rollouts with models whose predictions are known."""

from __future__ import annotations

import pytest
import torch

from iher_robot.learning.config import DynamicsConfig
from iher_robot.learning.imagination.dynamics import DynamicsEnsemble
from iher_robot.learning.imagination.rollout import ImaginedRollouts, imagine
from tests.learning.fakes import (
    CPU,
    deviation,
    drifting_ensemble,
    generator,
    linear_ensemble,
    perfect_ensemble,
)
from tests.learning.point_mass import MARK, SHAPES, STEP, PointMassGoals

OBS = SHAPES.obs_dim


def roll(
    ensemble: DynamicsEnsemble, start: torch.Tensor, *, ticks: int = 12, margin: float = 0.1
) -> ImaginedRollouts:
    """Rollouts whose goals are their row's number and whose action is a function of the state."""
    rows = torch.arange(float(len(start)))
    return imagine(
        ensemble,
        PointMassGoals(),
        start=start,
        goals=torch.stack([rows, rows], dim=-1),
        act=lambda observation: torch.cos(7 * observation[:, :2]),
        ticks=ticks,
        state_margin=margin,
        spread=lambda predictions: predictions.sum((0, 2)),
        generator=generator(3),
    )


def test_a_member_is_drawn_uniformly_for_each_rollout_at_each_step() -> None:
    # Member i moves entry 2 by i, which identifies the member of every step.
    rollouts = roll(drifting_ensemble(0.0, 1.0, 2.0, 3.0), torch.zeros(400, OBS), ticks=40)
    member = rollouts.observations[:, :, 2].diff(dim=1).long()
    assert member.shape == (400, 40)
    assert deviation(torch.bincount(member.flatten(), minlength=4), torch.ones(4)) < 4
    # A draw is independent of the rollout's previous one and of its neighbour's.
    for one, other in ((member[:, :-1], member[:, 1:]), (member[:-1], member[1:])):
        pairs = torch.bincount((4 * one + other).flatten(), minlength=16)
        assert deviation(pairs, torch.ones(16)) < 4


def test_rollouts_have_full_length_and_follow_policy_and_model() -> None:
    start = torch.randn(5, OBS, generator=generator())
    start = PointMassGoals().complete(start)
    rollouts = roll(perfect_ensemble(), start)
    assert rollouts.observations.shape == (5, 13, OBS)
    assert rollouts.actions.shape == (5, 12, SHAPES.action_dim)
    assert torch.equal(rollouts.observations[:, 0], start)
    before, after = rollouts.observations[:, :-1], rollouts.observations[:, 1:]
    # Each action is the one for the observation at its own tick, and moves to the next.
    torch.testing.assert_close(rollouts.actions, torch.cos(7 * before[..., :2]))
    torch.testing.assert_close(after[..., :2], before[..., :2] + STEP * rollouts.actions)
    torch.testing.assert_close(after[..., 2:4], STEP * rollouts.actions)
    assert rollouts.dropped == 0


def test_the_spread_is_that_of_the_predictions_at_its_own_tick() -> None:
    ensemble = perfect_ensemble(2)
    rollouts = roll(ensemble, torch.randn(4, OBS, generator=generator()), ticks=6)
    assert rollouts.spreads.shape == (4, 6)
    for tick in range(6):
        predictions = ensemble.predict(rollouts.observations[:, tick], rollouts.actions[:, tick])
        torch.testing.assert_close(rollouts.spreads[:, tick], predictions.sum((0, 2)))


def test_derived_entries_are_recomputed_and_not_predicted() -> None:
    ensemble = linear_ensemble([[0.1, -0.1, 0.0, 0.0, 7.0, -7.0]] * 2)
    rollouts = roll(ensemble, torch.zeros(3, OBS))
    imagined = rollouts.observations[:, 1:]
    mark = torch.as_tensor(MARK, dtype=torch.float32)
    torch.testing.assert_close(imagined[..., 4:6], imagined[..., :2] - mark)


@pytest.mark.parametrize(("margin", "low", "high"), [(0.0, -1.0, 2.0), (0.1, -1.3, 2.3)])
def test_observations_stay_within_the_real_range_widened_by_the_margin(
    margin: float, low: float, high: float
) -> None:
    ensemble = linear_ensemble([[0.5, -0.5, 0.5, -0.5, 0.0, 0.0]])
    ensemble.obs_low, ensemble.obs_high = torch.full((OBS,), -1.0), torch.full((OBS,), 2.0)
    observations = roll(ensemble, torch.zeros(2, OBS), margin=margin).observations
    assert observations[..., [0, 2]].max() == pytest.approx(high)
    assert observations[..., [1, 3]].min() == pytest.approx(low)
    # Derived entries follow from the bounded ones.
    torch.testing.assert_close(observations[:, -1, 4], observations[:, -1, 0] - float(MARK[0]))


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 100.0])
def test_rollouts_that_are_not_finite_are_dropped_and_counted_and_the_others_kept(
    bad: float,
) -> None:
    # Of three members only the last overflows, and only where entry 3 of the start is 100; the
    # bounds would make an infinite prediction finite again.
    ensemble = drifting_ensemble(0.0, 0.0, 0.0)
    state = ensemble.state_dict()
    state["members"]["2.0.weight"][2, 3] = 1e38
    ensemble.load_state_dict(state)
    ensemble.obs_low, ensemble.obs_high = torch.full((OBS,), -200.0), torch.full((OBS,), 200.0)
    start = torch.zeros(6, OBS)
    start[:, 0] = torch.arange(6.0)
    start[[1, 4], 3] = bad
    rollouts = roll(ensemble, start)
    assert rollouts.dropped == 2
    kept = [0.0, 2.0, 3.0, 5.0]
    assert rollouts.observations[:, 0, 0].tolist() == kept
    assert rollouts.goals[:, 0].tolist() == kept
    assert rollouts.observations.isfinite().all()
    torch.testing.assert_close(
        rollouts.actions[:, 0], torch.cos(7 * rollouts.observations[:, 0, :2])
    )
    assert len(rollouts.actions) == len(rollouts.spreads) == 4
    assert rollouts.spreads.isfinite().all()


def test_a_start_that_is_not_finite_is_dropped_even_if_predictions_are_finite() -> None:
    # Its only hidden unit is 0 at such a start, so that every prediction is finite.
    config = DynamicsConfig(members=1, hidden=(1,))
    ensemble = DynamicsEnsemble(SHAPES, config, generator=generator(), device=CPU)
    state = ensemble.state_dict()
    state["members"]["0.0.weight"] = -torch.ones(1, OBS + SHAPES.action_dim)
    ensemble.load_state_dict(state)
    start = torch.zeros(3, OBS)
    start[1, 3] = torch.inf
    rollouts = roll(ensemble, start)
    assert rollouts.dropped == 1
    assert rollouts.goals[:, 0].tolist() == [0.0, 2.0]


def test_no_rollout_is_kept_if_all_diverge() -> None:
    rollouts = roll(drifting_ensemble(float("nan"), 0.0), torch.zeros(3, OBS))
    assert rollouts.dropped == 3
    assert rollouts.observations.shape == (0, 13, OBS)
