"""One epoch of Algorithm 1: what is trained how often, and what each switch turns off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from iher_robot.learning.episode import Episode
from iher_robot.learning.goal_model import REAL
from iher_robot.learning.learner import Learner
from iher_robot.learning.replay import EpisodeReplay
from tests.learning.point_mass import SHAPES, PointMassGoals
from tests.learning.quick_learner import HER, after, new, quick, real, rows
from tests.learning.stand_ins import generator

TICKS = SHAPES.episode_ticks


def steps(optimizer: dict[str, Any]) -> set[int]:
    """How many steps an optimiser has taken, for each of its parameters."""
    return {int(state["step"]) for state in optimizer["state"].values()}


@pytest.mark.parametrize(("workers", "expected"), [(1, 64), (3, 192)])
def test_the_dynamics_are_trained_longest_in_the_first_epoch_on_batches_of_all_workers(
    workers: int, expected: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes = set()
    draw = EpisodeReplay.draw

    def spy(self: EpisodeReplay, count: int, *args: Any) -> tuple[torch.Tensor, torch.Tensor]:
        if args[1:]:  # weighted draws are those of the dynamics
            sizes.add((self.source, count))
        return draw(self, count, *args)

    monkeypatch.setattr(EpisodeReplay, "draw", spy)
    learner = new(quick(schedule={"workers": workers, "first_epoch_dynamics_factor": 5}))
    taken = []
    for epoch in (1, 2, 3):
        learner.add_real(real(epoch))
        learner.learn()
        taken.append(steps(learner.ensemble.state_dict()["optimizer"]))
    assert taken == [{5 * 6}, {5 * 6 + 6}, {5 * 6 + 12}]
    assert sizes == {(REAL, expected)}


def test_targets_are_updated_once_a_cycle_after_its_batches(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    learner = new(quick())
    calls = []
    update, update_targets = learner.ddpg.update, learner.ddpg.update_targets

    def updated(batch: Any) -> dict[str, torch.Tensor]:
        calls.append("update")
        return update(batch)

    def targets_updated() -> None:
        calls.append("targets")
        update_targets()

    monkeypatch.setattr(learner.ddpg, "update", updated)
    monkeypatch.setattr(learner.ddpg, "update_targets", targets_updated)
    learner.add_real(real(1))
    metrics = learner.learn()
    assert calls == ["update", "update", "update", "targets"] * 4
    assert metrics["updates"] == 12
    for name in ("actor_optimizer", "critic_optimizer"):
        assert steps(learner.ddpg.state_dict()[name]) == {12}


def test_a_copy_of_the_policy_is_kept_every_so_many_cycles_across_epochs() -> None:
    learner = after(2, quick(schedule={"cycles": 5, "policy_copy_cycles": 2}))
    copies = learner.state_dict()["imagined"]["policy_copies"]
    assert [cycle for cycle, _ in copies] == [2, 4, 6, 8, 10]
    actors = [snapshot["actor"]["0.weight"] for _, snapshot in copies]
    assert torch.equal(actors[-1], learner.policy.snapshot()["actor"]["0.weight"])
    assert not torch.equal(actors[-2], actors[-1])


def fresh_rewards(
    learner: Learner, observation: torch.Tensor, action: torch.Tensor
) -> np.ndarray[Any, Any]:
    """clip(nu sigma, 0, eta) in NumPy, from the models as they are now."""
    predictions = learner.ensemble.predict(observation, action).double().numpy()
    sigma = ((predictions - predictions.mean(0)) ** 2).mean(0)
    settings = learner.config.intrinsic
    sigma = sigma.sum(-1) if settings.reduce == "sum" else sigma.mean(-1)
    return np.asarray(np.clip(settings.scale * sigma, 0, settings.clip))


@pytest.mark.parametrize("regenerate", [True, False])
@pytest.mark.parametrize("reduce", ["mean", "sum"])
def test_every_cached_intrinsic_reward_equals_a_fresh_one(regenerate: bool, reduce: str) -> None:
    config = quick(
        imagination={"regenerate": regenerate},
        intrinsic={"reduce": reduce, "scale": 20.0 if reduce == "mean" else 3.0},
    )
    learner = after(3, config)
    for replay in (learner.real, learner.imagined.replay):
        batch = replay.sample(8000, generator(), PointMassGoals(), future_fraction=0.8)
        seen = torch.cat([batch.observation, batch.action, batch.next_observation], dim=-1)
        assert {tuple(row) for row in seen.tolist()} == rows(replay)  # every one was drawn
        expected = fresh_rewards(learner, batch.observation, batch.action)
        np.testing.assert_allclose(batch.intrinsic, expected, atol=1e-6, rtol=1e-4)
        assert (expected < 0.8).any()
        assert expected.std() > 0.01


def test_without_intrinsic_rewards_every_one_is_zero() -> None:
    learner = new(quick(intrinsic={"enabled": False}))
    for epoch in (1, 2):
        learner.add_real(real(epoch))
        metrics = learner.learn()
    assert metrics["intrinsic_imagined"] == 0
    for replay in (learner.real, learner.imagined.replay):
        batch = replay.sample(500, generator(), PointMassGoals(), future_fraction=0.8)
        assert (batch.intrinsic == 0).all()


def test_the_model_free_baseline_imagines_nothing_and_hears_no_source() -> None:
    learner = new(quick(**HER))
    untrained = learner.ensemble.state_dict()["members"]
    learner.add_real(real(1))
    metrics = learner.learn()
    assert learner.imagined.replay.num_episodes == 0
    assert (metrics["imagined_transitions"], metrics["imagined_share"]) == (0, 0)
    assert "dynamics_loss" not in metrics
    assert (learner.sample_batch().source == REAL).all()
    assert len(learner.sample_batch().source) == 50
    assert (learner.sample_batch().intrinsic == 0).all()
    assert learner.policy.input_dim == SHAPES.obs_dim + SHAPES.goal_dim
    for name, tensor in learner.ensemble.state_dict()["members"].items():
        assert torch.equal(tensor, untrained[name])


def test_progress_reaches_the_end_of_every_phase() -> None:
    seen: dict[str, list[tuple[int, int]]] = {}

    def progress(phase: str, done: int, total: int) -> None:
        seen.setdefault(phase, []).append((done, total))

    learner = new(quick(schedule={"dynamics_steps": 60}))
    for epoch in (1, 2):
        learner.add_real(real(epoch))
        learner.learn(progress)
    assert [total for done, total in seen["dynamics"] if done == total] == [300, 60]
    assert seen["imagine"][-1] == (8 * TICKS, 8 * TICKS)
    assert seen["update"][-1] == (12, 12)
    for steps_done in seen.values():
        assert all(0 < done <= total for done, total in steps_done)


@pytest.mark.parametrize("episodes", [[], [replace(real(1)[0], valid=np.zeros(TICKS, bool))]])
def test_learning_from_nothing_is_refused(episodes: Sequence[Episode]) -> None:
    for sections in ({}, HER):
        learner = new(quick(**sections))
        learner.add_real(episodes)
        with pytest.raises(ValueError, match="no real transition has been added"):
            learner.learn()


def test_models_that_diverge_stop_the_epoch_before_the_policy_sees_them() -> None:
    learner = new(quick())
    state = learner.ensemble.state_dict()
    state["members"]["0.0.bias"][:] = float("nan")
    learner.ensemble.load_state_dict(state)
    learner.add_real(real(1))
    with pytest.raises(FloatingPointError, match=r"lower learner\.dynamics\.lr"):
        learner.learn()
    for tensor in learner.policy.snapshot()["actor"].values():
        assert tensor.isfinite().all()
