"""Data of the learner: storage, mixture in a batch, statistics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from iher_robot.learning.episode import Episode
from iher_robot.learning.goal_model import IMAGINED, REAL
from iher_robot.learning.replay import EpisodeReplay
from tests.learning.fakes import CPU, generator, marked_episode, stored
from tests.learning.point_mass import SHAPES, PointMassGoals
from tests.learning.small_learner import after, new, quick, real, rows

TICKS = SHAPES.episode_ticks


def test_the_models_statistics_are_those_of_real_data_only() -> None:
    learner = after(2, quick())
    observation, action, following = stored(learner.real.replay)
    inputs = torch.cat([observation, action], dim=-1)
    torch.testing.assert_close(learner.ensemble.input_normalizer.mean, inputs.mean(0))
    every = torch.cat([observation, following])
    assert torch.equal(learner.ensemble.obs_low, every.amin(0))
    assert torch.equal(learner.ensemble.obs_high, every.amax(0))
    imagined = torch.cat([stored(learner.imagined.replay)[i] for i in (0, 2)])
    assert not torch.equal(imagined.amax(0), every.amax(0))


def test_imagined_data_never_enter_the_real_store() -> None:
    learner = new(quick())
    everything: list[Episode] = []
    for epoch in (1, 2):
        everything += real(epoch)
        learner.add_real(real(epoch))
        learner.learn()
        assert learner.imagined.replay.num_episodes > 0
        expected = EpisodeReplay(SHAPES, capacity=12_000, source=REAL, device=CPU)
        for e in everything:
            arrays = (torch.as_tensor(x)[None] for x in (e.observations, e.actions, e.desired_goal))
            expected.add(*arrays, epoch=1)
        for mine, theirs in zip(stored(learner.real.replay), stored(expected), strict=True):
            assert torch.equal(mine, theirs)


def test_real_transitions_carry_the_epoch_of_their_collection_also_after_a_restart() -> None:
    learner, resumed = new(quick()), new(quick())
    epochs = [[marked_episode(epoch, TICKS)] * epoch for epoch in (1, 2, 3)]
    for episodes in epochs:
        learner.add_real(episodes)
    resumed.load_state_dict(learner.state_dict(), epochs)
    for replay in (learner.real.replay, resumed.real.replay):
        for epoch in (1, 2, 3):
            only = torch.eye(4)[epoch]
            _, action, _ = replay.steps(*replay.sample_indices(100, generator(), only))
            assert set(action[:, 0].tolist()) == {float(epoch)}


def holes() -> tuple[Episode, set[int]]:
    valid = np.ones(TICKS, dtype=bool)
    valid[[3, 7]] = False
    return replace(marked_episode(0, TICKS), valid=valid), set(np.flatnonzero(valid).tolist())


def test_neither_a_transition_nor_hindsight_spans_an_invalid_tick() -> None:
    learner = new(quick())
    episode, valid = holes()
    learner.add_real([episode])
    batch = learner.real.replay.sample(3000, generator(), PointMassGoals(), future_fraction=0.8)
    tick, goal_tick = batch.action[:, 1].int(), batch.goal[:, 1].int()
    assert set(tick.tolist()) == valid
    hindsight = batch.goal[:, 0] != -1
    for begin, end in ((0, 3), (4, 7), (8, TICKS)):
        mine = hindsight & (tick >= begin) & (tick < end)
        assert mine.any()
        assert goal_tick[mine].max() == end
        assert (goal_tick > tick)[mine].all()


def test_the_share_of_imagined_transitions_is_that_of_newly_collected_ones() -> None:
    # The imaginary source keeps 3 rollouts only, and refills add none to the count.
    learner = new(quick(replay={"capacity": 3 * TICKS}))
    collected = 0
    for epoch in (1, 2, 3):
        episode, valid = holes()
        learner.add_real([*real(epoch, 3), episode])
        collected += 3 * TICKS + len(valid)
        metrics = learner.learn()
        imagined = epoch * 4 * 2 * TICKS
        assert metrics["real_transitions"] == collected
        assert metrics["imagined_transitions"] == imagined
        assert metrics["imagined_stored"] == 3 * TICKS
        assert metrics["imagined_share"] == pytest.approx(imagined / (imagined + collected))
        sources = learner.sample_block(1).source
        assert len(sources) == 50
        assert int((sources == IMAGINED).sum()) == round(50 * imagined / (imagined + collected))


def test_a_batch_is_as_large_as_those_of_all_workers() -> None:
    learner = new(quick(schedule={"workers": 3}))
    learner.add_real(real(1))
    assert len(learner.sample_block(1).source) == 150


def test_batches_sampled_together_have_the_size_and_mixture_of_one() -> None:
    learner = new(quick(imagination={"share": 0.4}))
    learner.add_real(real(1))
    learner.learn()
    batches = learner.sample_block(7).split(7)
    assert [len(batch.observation) for batch in batches] == [50] * 7
    assert [int((batch.source == IMAGINED).sum()) for batch in batches] == [20] * 7
    assert len({batch.goal.sum().item() for batch in batches}) == 7


def test_the_policys_statistics_are_those_of_real_data_and_relabelled_goals() -> None:
    def goal_mean(fraction: float) -> float:
        learner = new(quick(replay={"future_fraction": fraction}))
        far = [replace(e, desired_goal=np.full(2, 100.0)) for e in real(1, 60)]
        learner.add_real(far)
        return float(learner.policy.goal_normalizer.mean.mean())

    assert goal_mean(0.0) == pytest.approx(100.0)
    assert abs(goal_mean(1.0)) < 1.0
    assert goal_mean(0.8) == pytest.approx(20.0, abs=6.0)

    learner = new(quick())
    for epoch in (1, 2):  # shifted by epoch, so that counting one twice would show
        moved = [replace(e, observations=e.observations + epoch) for e in real(epoch, 100)]
        learner.add_real(moved)
    observation, _, _ = stored(learner.real.replay)
    normalizer = learner.policy.obs_normalizer
    torch.testing.assert_close(normalizer.mean, observation.mean(0), atol=0.01, rtol=0)
    torch.testing.assert_close(normalizer.std, observation.std(0), atol=0.01, rtol=0)
    assert int(normalizer.state_dict()["count"]) == len(observation)


def test_imagination_never_changes_the_policys_statistics() -> None:
    learner = new(quick())
    learner.add_real(real(1))
    normalizers = learner.policy.obs_normalizer, learner.policy.goal_normalizer
    before = [normalizer.state_dict() for normalizer in normalizers]
    learner.learn()
    for normalizer, state in zip(normalizers, before, strict=True):
        for name, value in normalizer.state_dict().items():
            assert torch.equal(value, state[name]), name


@pytest.mark.parametrize("regenerate", [True, False])
def test_old_imagined_data_survive_a_model_update_only_without_regeneration(
    regenerate: bool,
) -> None:
    learner = new(quick(imagination={"regenerate": regenerate}))
    learner.add_real(real(1))
    learner.learn()
    old = rows(learner.imagined.replay)
    learner.add_real(real(2))
    learner.learn()
    new_rows = rows(learner.imagined.replay)
    assert len(new_rows) == 2 * len(old)
    assert (old & new_rows) == (set() if regenerate else old)


def test_without_regeneration_the_oldest_imagined_data_go_first() -> None:
    config = quick(imagination={"regenerate": False}, replay={"capacity": 12 * TICKS})
    learner = new(config)
    learner.add_real(real(1))
    learner.learn()  # 8 rollouts
    _, old, _ = stored(learner.imagined.replay)
    learner.add_real(real(2))
    learner.learn()  # 8 more, for 12 places
    _, now, _ = stored(learner.imagined.replay)
    assert {tuple(row) for row in old.tolist()} & {tuple(row) for row in now.tolist()} == {
        tuple(row) for row in old[4 * TICKS :].tolist()
    }


@pytest.mark.parametrize("actions", ["applied", "between"])
def test_requested_actions_reach_policy_and_models_only_with_between(
    actions: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    learner = new(quick(replay={"actions": actions}))
    episodes = [
        replace(e, actions=e.actions * 0, requested_actions=e.actions * 0 + 1.0) for e in real(1)
    ]
    seen = []
    inputs = learner.ensemble._inputs

    def spy(observation: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        seen.append(action)
        return inputs(observation, action)

    monkeypatch.setattr(learner.ensemble, "_inputs", spy)
    learner.add_real(episodes)
    learner.ensemble.fit_normalizers(learner.real.replay, learner.generator)
    learner.ensemble.train(learner.real.replay, 2, batch_size=64, generator=learner.generator)
    for action in (learner.sample_block(1).action, seen[-1]):
        assert (action >= 0).all()
        assert (action <= 1).all()
        assert bool((action > 0).any()) is (actions == "between")
