"""One epoch of Algorithm 1: order and number of its steps, and effect of each switch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from iher_robot.learning.episode import Episode
from iher_robot.learning.goal_model import REAL
from iher_robot.learning.learner import Learner
from iher_robot.learning.replay import EpisodeReplay
from iher_robot.learning.transitions import Transitions
from tests.learning.fakes import FarAwaySymmetry, deviation, generator, same, stored
from tests.learning.point_mass import SHAPES, PointMassGoals
from tests.learning.small_learner import HER, after, new, quick, real, rows

TICKS = SHAPES.episode_ticks


def steps(optimizer: dict[str, Any]) -> set[int]:
    """How many steps an optimiser has taken, for each of its parameters."""
    return {int(state["step"]) for state in optimizer["state"].values()}


@pytest.mark.parametrize(("workers", "expected"), [(1, 64), (3, 192)])
def test_the_dynamics_are_trained_longest_in_the_first_epoch_on_batches_of_all_workers(
    workers: int, expected: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes = set()
    draw = EpisodeReplay.sample_indices

    def spy(self: EpisodeReplay, count: int, *args: Any) -> tuple[torch.Tensor, torch.Tensor]:
        if args[1:]:  # only the dynamics use epoch weights
            sizes.add((self.source, count))
        return draw(self, count, *args)

    monkeypatch.setattr(EpisodeReplay, "sample_indices", spy)
    learner = new(quick(schedule={"workers": workers, "first_epoch_dynamics_factor": 5}))
    taken = []
    for epoch in (1, 2, 3):
        learner.add_real(real(epoch))
        learner.learn()
        taken.append(steps(learner.ensemble.state_dict()["optimizer"]))
    assert taken == [{5 * 6}, {5 * 6 + 6}, {5 * 6 + 12}]
    assert sizes == {(REAL, learner.config.dynamics.members * expected)}


def test_targets_are_updated_once_a_cycle_after_its_batches(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    learner = new(quick())
    calls = []
    update, update_targets = learner.ddpg.update_block, learner.ddpg.update_targets

    def updated(block: Any, count: int) -> dict[str, torch.Tensor]:
        calls.extend(["update"] * count)
        return update(block, count)

    def targets_updated() -> None:
        calls.append("targets")
        update_targets()

    monkeypatch.setattr(learner.ddpg, "update_block", updated)
    monkeypatch.setattr(learner.ddpg, "update_targets", targets_updated)
    learner.add_real(real(1))
    metrics = learner.learn()
    assert calls == ["update", "update", "update", "targets"] * 4
    assert metrics["updates"] == 12
    for optimizer in learner.ddpg.state_dict()["optimizers"].values():
        assert steps(optimizer) == {12}


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
    for replay in (learner.real.replay, learner.imagined.replay):
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
    for replay in (learner.real.replay, learner.imagined.replay):
        batch = replay.sample(500, generator(), PointMassGoals(), future_fraction=0.8)
        assert (batch.intrinsic == 0).all()


def test_the_model_free_baseline_imagines_nothing_and_has_no_source_input() -> None:
    learner = new(quick(**HER))
    untrained = learner.ensemble.state_dict()["members"]
    learner.add_real(real(1))
    metrics = learner.learn()
    assert learner.imagined.replay.num_episodes == 0
    assert (metrics["imagined_transitions"], metrics["imagined_share"]) == (0, 0)
    assert "dynamics_loss" not in metrics
    assert (learner.sample_block(1).source == REAL).all()
    assert len(learner.sample_block(1).source) == 50
    assert (learner.sample_block(1).intrinsic == 0).all()
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


def test_the_updates_of_an_epoch_are_proportional_to_its_valid_steps() -> None:
    valid = np.ones(TICKS, bool)
    valid[[3, 7]] = False
    epochs = [real(1), [replace(real(2)[0], valid=valid), *real(2)[1:3]], real(3, 1)]
    for per_step, expected in ((0.5, [24, 17, 6]), (1.0, [48, 34, 12]), (None, [12, 12, 12])):
        learner = new(quick(schedule={"updates_per_step": per_step or "off"}, **HER))
        ends: list[int] = []
        end_cycle = learner.ddpg.end_cycle

        def ended(
            learner: Learner = learner,
            ends: list[int] = ends,
            end_cycle: Callable[[], None] = end_cycle,
        ) -> None:
            ends.append(learner.updates)
            end_cycle()

        learner.ddpg.end_cycle = ended  # type: ignore[method-assign]
        total = 0
        for episodes, updates in zip(epochs, expected, strict=True):
            ends.clear()
            learner.add_real(episodes)
            assert learner.learn()["updates"] == total + updates
            # Cycles of three updates, and of what is left.
            assert ends == [total + min(done + 3, updates) for done in range(0, updates, 3)]
            total += updates
            for optimizer in learner.ddpg.state_dict()["optimizers"].values():
                assert steps(optimizer) == {total}


def test_rewards_use_the_configured_tolerance() -> None:
    strict = new(quick(replay={"tolerance": 0.4}))
    strict.add_real(real(1, 40))
    block = strict.sample_block(20)
    goals = PointMassGoals()
    met = {
        share: goals.tightened(share).compute_reward(
            goals.achieved_goal(block.next_observation), block.goal
        )
        for share in (0.4, 1.0)
    }
    assert torch.equal(block.extrinsic, met[0.4])
    assert (met[0.4] < met[1.0]).any()


def test_an_epoch_has_at_least_one_update() -> None:
    learner = new(quick(schedule={"updates_per_step": 0.001}, **HER))
    learner.add_real(real(1, 1))
    assert learner.learn()["updates"] == 1


def moving(number: int, farthest_m: float) -> Episode:
    """An episode whose achieved goal moves away and returns."""
    episode = real(1, 1)[0]
    observations = np.zeros_like(episode.observations)
    observations[:, 2] = number
    observations[5, 1] = farthest_m
    return replace(episode, observations=observations)


def test_episodes_that_did_not_move_the_achieved_goal_are_drawn_less() -> None:
    config = quick(replay={"still_weight": 0.25, "moved_m": 0.01})
    episodes = [moving(0, 0.0), moving(1, 0.009), moving(2, 0.011), moving(3, -0.5)]
    learner, resumed, plain = new(config), new(config), new(quick())
    for each in (learner, plain):
        each.add_real(episodes)
    resumed.load_state_dict(learner.state_dict(), [episodes])
    for each, share in ((learner, 0.1), (resumed, 0.1), (plain, 0.25)):
        batch = each.real.replay.sample(10_000, generator(), PointMassGoals(), future_fraction=0.8)
        counts = torch.bincount(batch.observation[:, 2].long(), minlength=4)
        expected = torch.tensor([share, share, 0.5 - share, 0.5 - share])
        assert deviation(counts, expected) < 4


def test_with_symmetry_everything_is_learned_from_images() -> None:
    config = quick(symmetry={"enabled": True}, contact={"enabled": True})
    goals = PointMassGoals()
    learner = new(config, symmetry=FarAwaySymmetry(), contact_model=goals)
    batches: list[Transitions] = []
    assert learner.contact is not None
    for ddpg in (learner.ddpg, learner.contact.ddpg):
        update = ddpg.update_block

        def seen(block: Transitions, count: int, update: Any = update) -> Any:
            batches.extend(block.split(count))
            return update(block, count)

        ddpg.update_block = seen  # type: ignore[method-assign]
    learner.add_real(real(1))
    real_rows = {tuple(row) for row in learner.real.replay.start_observations()[:, :2].tolist()}
    learner.learn()
    actions = {tuple(row) for row in stored(learner.real.replay)[1].tolist()}
    assert len(batches) == 12 + 4 * TICKS
    for index, batch in enumerate(batches):
        is_real = batch.source == REAL
        away = batch.observation[is_real, 0]
        assert ((away > 99) & (away < 201)).all()
        assert away.std() > 20  # an image for each row
        for entry in (batch.next_observation, batch.goal):
            assert (entry[is_real, 0] - away).abs().max() < 2  # the same image
        assert {tuple(row) for row in (-batch.action[is_real]).tolist()} <= actions
        # Rewards stay, and are those of the images.
        achieved = goals.achieved_goal(batch.next_observation)
        gap = (achieved - batch.goal).square().sum(-1).sqrt()
        clear = (gap - (0.03 if index < 4 * TICKS else 0.05)).abs() > 1e-3
        met = gap < (0.03 if index < 4 * TICKS else 0.05)
        assert torch.equal((batch.extrinsic == 0)[clear], met[clear])
    # The models know images only, imagination starts from them, and the data stay as they were.
    assert (learner.ensemble.obs_low[:2] > 99).all()
    assert (learner.imagined.replay.start_observations()[:, :2] > 99).all()
    after = {tuple(row) for row in learner.real.replay.start_observations()[:, :2].tolist()}
    assert after == real_rows


def test_a_symmetry_that_is_not_enabled_changes_nothing() -> None:
    declared, plain = new(quick(), symmetry=FarAwaySymmetry()), new(quick())
    for learner in (declared, plain):
        learner.add_real(real(1))
        learner.learn()
    assert same(declared.policy.snapshot(), plain.policy.snapshot())
    assert torch.equal(declared.ensemble.obs_low, plain.ensemble.obs_low)
