"""Hindsight replay: storage, sampling, relabelling."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from iher_robot.learning.goal_model import IMAGINED, REAL
from iher_robot.learning.replay import EpisodeReplay
from iher_robot.learning.transitions import Transitions
from tests.learning.fakes import (
    CPU,
    deviation,
    generator,
    marked_episode,
    replay_of,
    store,
    stored,
)
from tests.learning.point_mass import SHAPES, PointMassGoals

TICKS = SHAPES.episode_ticks
lengths_strategy = st.lists(st.integers(1, TICKS), min_size=1, max_size=8)


def sample(replay: EpisodeReplay, count: int, fraction: float, seed: int = 0) -> Transitions:
    return replay.sample(count, generator(seed), PointMassGoals(), future_fraction=fraction)


@settings(deadline=None, max_examples=60)
@given(lengths_strategy, st.floats(0, 1), st.integers(0, 2**31))
def test_samples_are_consistent_transitions_with_goals_from_their_own_future(
    lengths: list[int], fraction: float, seed: int
) -> None:
    replay = replay_of([marked_episode(n, length) for n, length in enumerate(lengths)])
    batch = sample(replay, 256, fraction, seed)
    number, tick = batch.observation[:, 0], batch.observation[:, 1]
    assert torch.equal(batch.action, batch.observation[:, :2])
    assert torch.equal(batch.next_observation[:, 0], number)
    assert torch.equal(batch.next_observation[:, 1], tick + 1)

    relabelled = batch.goal[:, 0] != -1
    assert torch.equal(batch.goal[~relabelled, 1], number[~relabelled])  # the desired goal
    goal_number, goal_tick = batch.goal[relabelled].unbind(-1)
    assert torch.equal(goal_number, number[relabelled])
    assert (goal_tick > tick[relabelled]).all()
    assert (goal_tick <= torch.tensor(lengths)[goal_number.long()]).all()


@settings(deadline=None, max_examples=60)
@given(lengths_strategy, st.floats(0, 1), st.integers(0, 2**31))
def test_the_reward_is_that_of_the_next_observation_under_the_goal(
    lengths: list[int], fraction: float, seed: int
) -> None:
    replay = replay_of([marked_episode(n, length) for n, length in enumerate(lengths)])
    batch = sample(replay, 256, fraction, seed)
    goals = PointMassGoals()
    achieved = goals.achieved_goal(batch.next_observation)
    assert torch.equal(batch.extrinsic, goals.compute_reward(achieved, batch.goal))
    # Without the goal model: the goal is met where it equals the next tick's achieved goal.
    met = (batch.goal == batch.next_observation[:, :2]).all(-1)
    assert torch.equal(batch.extrinsic == 0, met)
    assert (batch.extrinsic[~met] == -1).all()


def test_hindsight_is_uniform_over_all_later_ticks_the_last_included() -> None:
    batch = sample(replay_of([marked_episode(0, TICKS)]), 60_000, 1.0)
    counts = torch.zeros(TICKS, TICKS + 1)
    tick, goal_tick = batch.observation[:, 1].long(), batch.goal[:, 1].long()
    counts.index_put_((tick, goal_tick), torch.ones(len(tick)), accumulate=True)
    row, column = torch.triu_indices(TICKS, TICKS + 1, offset=1)
    assert counts[row, column].sum() == len(tick)
    assert deviation(counts[row, column], 1.0 / (TICKS - row)) < 4


@pytest.mark.parametrize("fraction", [0.0, 0.3, 0.8, 1.0])
def test_the_share_of_relabelled_transitions(fraction: float) -> None:
    batch = sample(replay_of([marked_episode(n, TICKS) for n in range(3)]), 20_000, fraction)
    share = float((batch.goal[:, 0] != -1).float().mean())
    assert share == pytest.approx(fraction, abs=4 * (fraction * (1 - fraction) / 20_000) ** 0.5)


def test_draws_are_uniform_over_transitions_not_over_episodes() -> None:
    replay = replay_of([marked_episode(n, length) for n, length in enumerate([12, 1, 3, 12, 7])])
    episode, tick = replay.sample_indices(40_000, generator())
    counts = torch.zeros(5, TICKS)
    counts.index_put_((episode, tick), torch.ones(len(tick)), accumulate=True)
    drawable = counts[replay.all_indices()]
    assert drawable.sum() == len(tick)
    assert deviation(drawable, torch.ones(len(drawable))) < 4


def test_draws_follow_the_weights_of_the_epochs() -> None:
    replay = replay_of()
    for number, (epoch, length) in enumerate([(1, 12), (2, 2), (2, 7), (3, 5), (4, 1)]):
        store(replay, [marked_episode(number, length)], epoch)
    weights = torch.tensor([9.0, 0.5, 1.0, 0.0, 3.0])
    episode, tick = replay.sample_indices(40_000, generator(), weights)
    counts = torch.zeros(5, TICKS)
    counts.index_put_((episode, tick), torch.ones(len(tick)), accumulate=True)
    assert counts[3].sum() == 0  # epoch 3 weighs nothing
    for number, (share, length) in {0: (0.5, 12), 1: (1.0, 2), 2: (1.0, 7), 4: (3.0, 1)}.items():
        expected = share * length / (0.5 * 12 + 1.0 * 9 + 3.0)
        assert counts[number].sum() / 40_000 == pytest.approx(expected, abs=0.01)
    first = counts[0, :12]
    assert deviation(first, torch.ones(12)) < 4
    # A weighted draw does not affect uniform ones.
    again, _ = replay.sample_indices(40_000, generator())
    assert (again == 3).float().mean() == pytest.approx(5 / 27, abs=0.01)


def test_draws_follow_the_weights_of_the_episodes_unless_epoch_weights_are_given() -> None:
    lengths, weights = [12, 3, 7, 12, 1], [1.0, 0.25, 0.25, 1.0, 4.0]

    def frequencies(replay: EpisodeReplay, *epoch_weights: torch.Tensor) -> torch.Tensor:
        counts = torch.zeros(5, TICKS)
        drawn = replay.sample_indices(40_000, generator(), *epoch_weights)
        counts.index_put_(drawn, torch.ones(40_000), accumulate=True)
        assert counts[replay.all_indices()].sum() == 40_000
        return counts[replay.all_indices()]

    replay = replay_of()
    for number, (length, weight) in enumerate(zip(lengths, weights, strict=True)):
        store(replay, [marked_episode(number, length)], weight=weight)
    a_tick = torch.tensor(weights).repeat_interleave(torch.tensor(lengths))
    assert deviation(frequencies(replay), a_tick) < 4
    assert deviation(frequencies(replay), torch.ones(len(a_tick))) > 50
    assert deviation(frequencies(replay, torch.ones(2)), torch.ones(len(a_tick))) < 4
    batch = sample(replay, 40_000, 0.8)
    share = (batch.observation[:, 0] == 4).float().mean()
    assert float(share) == pytest.approx(4 / float(a_tick.sum()), abs=0.01)


def test_a_weight_is_dropped_with_its_episode() -> None:
    replay = replay_of(capacity=2 * TICKS)
    for number, weight in ((0, 1.0), (1, 1e-6), (2, 1.0), (3, 1.0)):
        store(replay, [marked_episode(number, TICKS)], weight=weight)
        replay.sample_indices(1, generator())
        seen = set(sample(replay, 200, 0.0).observation[:, 0].tolist())
        assert seen == {0: {0}, 1: {0}, 2: {2}, 3: {2, 3}}[number]


@settings(deadline=None, max_examples=60)
@given(
    st.integers(0, 80),
    st.lists(st.tuples(st.integers(1, 9), st.integers(1, TICKS)), min_size=1, max_size=8),
    st.integers(0, 2**31),
)
def test_first_in_first_out(capacity: int, batches: list[tuple[int, int]], seed: int) -> None:
    replay = replay_of(capacity=capacity)
    everything: list[tuple[int, int]] = []
    for epoch, (count, length) in enumerate(batches, start=1):
        episodes = [marked_episode(len(everything) + i, length) for i in range(count)]
        everything += [(len(everything) + i, length) for i in range(count)]
        replay.add(
            torch.stack([torch.as_tensor(e.observations) for e in episodes]),
            torch.stack([torch.as_tensor(e.actions) for e in episodes]),
            torch.stack([torch.as_tensor(e.desired_goal) for e in episodes]),
            epoch=epoch,
        )
        assert replay.newest_epoch == epoch
        newest = everything[-max(1, capacity // TICKS) :]
        assert replay.num_episodes == len(newest)
        assert replay.num_transitions == sum(length for _, length in newest)

    kept = {(number, tick) for number, length in newest for tick in range(length)}
    observation, action, following = stored(replay)
    assert {tuple(row) for row in action.int().tolist()} == kept
    assert len(action) == len(kept)
    assert torch.equal(observation[:, :2], action)
    assert torch.equal(following[:, 1], action[:, 1] + 1)
    starts = replay.start_observations()
    assert sorted(starts[:, 0].tolist()) == [number for number, _ in newest]
    assert (starts[:, 1] == 0).all()
    batch = sample(replay, 64, 0.5, seed)
    assert {tuple(row) for row in batch.action.int().tolist()} <= kept


def test_a_cleared_replay_is_empty_and_sampling_it_names_the_source() -> None:
    replay = replay_of([marked_episode(n, TICKS) for n in range(4)], source=IMAGINED)
    replay.sample_indices(1, generator())
    replay.clear()
    assert (replay.num_episodes, replay.num_transitions, replay.newest_epoch) == (0, 0, 0)
    with pytest.raises(ValueError, match=f"source {IMAGINED} holds no episode"):
        sample(replay, 1, 0.8)
    store(replay, [marked_episode(9, 3)])
    assert set(sample(replay, 100, 0.0).action[:, 0].tolist()) == {9.0}


def test_a_cached_intrinsic_reward_is_stored_and_dropped_with_its_transition() -> None:
    replay = replay_of([marked_episode(n, 5) for n in range(2)], capacity=2 * TICKS)
    assert (sample(replay, 50, 0.0).intrinsic == 0).all()
    episode, tick = replay.all_indices()
    replay.store_intrinsic(episode, tick, 10.0 * episode + tick)
    batch = sample(replay, 200, 0.5)
    assert torch.equal(batch.intrinsic, 10 * batch.action[:, 0] + batch.action[:, 1])
    store(replay, [marked_episode(2, TICKS)])  # takes the oldest one's place
    batch = sample(replay, 200, 0.5)
    assert set(batch.intrinsic[batch.action[:, 0] == 2].tolist()) == {0.0}
    assert (batch.intrinsic[batch.action[:, 0] == 1] >= 10).all()


def test_each_batch_of_a_block_has_its_share_of_every_source() -> None:
    real = sample(replay_of([marked_episode(1, TICKS)]), 6, 0.0)
    imagined = sample(replay_of([marked_episode(2, TICKS)], source=IMAGINED), 4, 0.0)
    block = Transitions.interleave([real, imagined], 2)
    assert block.source.tolist() == 2 * [0, 0, 0, 1, 1]
    assert block.action[:, 0].tolist() == 2 * [1, 1, 1, 2, 2]
    goals = [real.goal[:3], imagined.goal[:2], real.goal[3:], imagined.goal[2:]]
    assert torch.equal(block.goal, torch.cat(goals))
    for batch in block.split(2):
        assert batch.source.tolist() == [0, 0, 0, 1, 1]


@pytest.mark.parametrize("between", [False, True])
def test_actions_are_applied_ones_or_between_applied_and_requested_ones(
    between: bool,
) -> None:
    replay = EpisodeReplay(SHAPES, capacity=1200, source=REAL, device=CPU, between=between)
    shape = (3, SHAPES.episode_ticks, SHAPES.action_dim)
    applied, requested = torch.full(shape, 0.2), torch.full(shape, 1.0)
    requested[..., 1] = -0.6
    observations = torch.zeros(3, SHAPES.episode_ticks + 1, SHAPES.obs_dim)
    goals = torch.zeros(3, SHAPES.goal_dim)
    replay.add(observations, applied, goals, epoch=1, requested=requested)
    replay.add(observations, -applied, goals, epoch=1)  # no request was clipped
    action = replay.sample(4000, generator(), PointMassGoals(), future_fraction=0.8).action
    first = action[action[:, 0] > 0]
    assert (action[action[:, 0] < 0] == -0.2).all()
    assert len(first) == pytest.approx(2000, abs=150)
    share = (first[:, 0] - 0.2) / 0.8
    torch.testing.assert_close(first[:, 1], 0.2 - 0.8 * share)  # one share for a whole action
    if between:
        assert float(share.mean()) == pytest.approx(0.5, abs=0.03)
        assert float(share.std()) == pytest.approx(12**-0.5, abs=0.03)
    else:
        assert (share == 0).all()
    assert torch.equal(stored(replay)[1][:5], applied[0, :5])


@settings(deadline=None, max_examples=30)
@given(st.integers(1, 4), lengths_strategy, st.booleans())
def test_a_restored_replay_samples_and_overwrites_like_the_original(
    capacity: int, lengths: list[int], between: bool
) -> None:
    first, second = (
        EpisodeReplay(SHAPES, capacity=capacity * TICKS, source=REAL, device=CPU, between=between)
        for _ in range(2)
    )
    for number, length in enumerate(lengths):
        store(first, [marked_episode(number, length)])
    state = first.state_dict()
    held = sum(tensor.untyped_storage().nbytes() for tensor in list(state.values())[:-1])
    requested = SHAPES.action_dim if between else 0
    floats = (TICKS + 1) * SHAPES.obs_dim + TICKS * (SHAPES.action_dim + requested + 1)
    assert held == first.num_episodes * (4 * (floats + SHAPES.goal_dim) + 3 * 8)

    second.load_state_dict(state)

    store(first, [marked_episode(99, 1)])
    store(second, [marked_episode(99, 1)])
    one, two = sample(first, 64, 0.5), sample(second, 64, 0.5)
    for name in Transitions.__dataclass_fields__:
        assert torch.equal(getattr(one, name), getattr(two, name)), name
