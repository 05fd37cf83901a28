"""Exploration: noise, and the second policy that acts until the object is touched."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from iher_robot.learning.config import ContactConfig, ExplorationConfig
from iher_robot.learning.contact.approach import LEG_TICKS, ContactPolicy
from iher_robot.learning.exploration import Explorer, explore
from tests.learning.fakes import NO_NOISE, deviation, generator, linear_policy
from tests.learning.point_mass import MARK, PointMassGoals, observe

MINE, THEIRS = 0.25, 0.9
OFF_RADIUS = 0.06


def explorer(share: float, exploration: ExplorationConfig = NO_NOISE) -> Explorer:
    """An explorer whose second policy always acts THEIRS, in every entry."""
    policy = linear_policy([float(torch.atanh(torch.tensor(THEIRS)))] * 2)
    config = ContactConfig(enabled=True, share=share, radius_m=0.05)
    return Explorer(exploration, ContactPolicy(policy, PointMassGoals(), config, rests=False))


def explorer_with_points(again_m: float | None = None) -> Explorer:
    """An explorer whose approaches all pass a point around the object, at most 1 m away an axis."""
    config = ContactConfig(
        enabled=True, share=1.0, radius_m=0.05, around_share=1.0, around_m=1.0, again_m=again_m
    )
    return Explorer(
        NO_NOISE, ContactPolicy(linear_policy(goal_gain=1.0), PointMassGoals(), config, rests=False)
    )


def at(*offset_m: float, mark_m: float = 0.0) -> torch.Tensor:
    """Observation at an offset from the mark, which was moved along x."""
    away = np.array([*offset_m, 0.0])[:2]
    position = MARK + np.array([mark_m, 0.0]) + away
    observation = observe(position, position * 0)
    observation[4:6] = away
    return torch.as_tensor(observation, dtype=torch.float32)[None]


def target_of(act: torch.Tensor, offset_m: tuple[float, float]) -> np.ndarray:
    """Target, relative to the mark, of a policy of gain 1 with this action at this offset."""
    return np.asarray(torch.atanh(act[0]).numpy() + offset_m)


def taken_over(explorer: Explorer, steps: int, distance_m: float, seed: int = 0) -> float:
    """Share of the steps, all at one distance, that the second policy takes."""
    rng, mine = generator(seed), torch.full((1, 2), MINE)
    acts = torch.cat([explorer.act(at(distance_m), mine, rng) for _ in range(steps)])
    theirs = (acts - THEIRS).abs().amax(-1) < 1e-5
    assert (acts[~theirs] == MINE).all()
    return float(theirs.float().mean())


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_the_second_policy_takes_its_share_of_the_steps_before_the_touch(share: float) -> None:
    exploring = explorer(share)
    exploring.begin()
    assert taken_over(exploring, 2000, OFF_RADIUS) == pytest.approx(share, abs=0.04)


def test_after_a_touch_it_acts_no_more_in_the_episode() -> None:
    exploring = explorer(1.0)
    for episode in range(3):
        exploring.begin()
        assert taken_over(exploring, 5, OFF_RADIUS, episode) == 1.0
        assert taken_over(exploring, 1, 0.04, episode) == 0.0
        assert taken_over(exploring, 20, OFF_RADIUS, episode) == 0.0


def test_an_object_that_moved_counts_as_touched() -> None:
    exploring = explorer(1.0)
    rng, mine = generator(), torch.full((1, 2), MINE)
    for moved, theirs in ((0.0, True), (0.009, True), (0.011, False), (0.0, False)):
        act = exploring.act(at(OFF_RADIUS, mark_m=moved), mine, rng)
        assert torch.equal(act, mine) is not theirs, moved


def test_an_approach_goes_to_a_point_around_the_object_and_then_to_it() -> None:
    mine, drawn = torch.full((1, 2), MINE), []
    for seed in range(200):
        exploring, rng = explorer_with_points(), generator(seed)
        exploring.begin()
        place = target_of(exploring.act(at(1.2), mine, rng), (1.2, 0.0))
        drawn.append(place.copy())
        # A touch or push on the way there does not end the leg.
        act = exploring.act(at(0.0, mark_m=0.3), mine, rng)
        place[0] -= 0.3  # relative to the mark now
        np.testing.assert_allclose(target_of(act, (0.0, 0.0)), place, atol=1e-4)
        # From there it goes to the object, until that moves.
        act = exploring.act(at(*place, mark_m=0.3), mine, rng)
        if np.linalg.norm(place) > 0.05:
            np.testing.assert_allclose(target_of(act, tuple(place)), 0.0, atol=1e-4)
            act = exploring.act(at(0.5, mark_m=0.305), mine, rng)
            np.testing.assert_allclose(target_of(act, (0.5, 0.0)), 0.0, atol=1e-4)
        assert torch.equal(exploring.act(at(0.5, mark_m=0.32), mine, rng), mine)
    assert np.abs(drawn).max(0) == pytest.approx([1.0, 1.0], abs=0.05)
    assert np.mean(drawn, axis=0) == pytest.approx([0.0, 0.0], abs=0.15)


def test_it_approaches_again_after_each_push_if_configured() -> None:
    exploring, rng, mine = explorer_with_points(again_m=0.1), generator(3), torch.full((1, 2), MINE)
    exploring.begin()
    places = []
    for pushes in range(5):
        mark_m = 0.11 * pushes
        place = target_of(exploring.act(at(1.2, mark_m=mark_m), mine, rng), (1.2, 0.0))
        places.append(tuple(place.round(3)))
        act = exploring.act(at(*place, mark_m=mark_m), mine, rng)
        np.testing.assert_allclose(target_of(act, tuple(place)), 0.0, atol=1e-4)
        act = exploring.act(at(0.2, mark_m=mark_m + 0.09), mine, rng)  # not yet far enough
        np.testing.assert_allclose(target_of(act, (0.2, 0.0)), 0.0, atol=1e-4)
    assert len(set(places)) == 5


def test_a_point_that_is_not_reached_is_given_up() -> None:
    exploring, rng, mine = explorer_with_points(), generator(3), torch.full((1, 2), MINE)
    exploring.begin()
    places = [
        target_of(exploring.act(at(1.2), mine, rng), (1.2, 0.0)) for _ in range(LEG_TICKS + 2)
    ]
    assert all(np.abs(place).max() > 0.05 for place in places[:LEG_TICKS])
    np.testing.assert_allclose(places[-1], 0.0, atol=1e-4)


class HandGoals(PointMassGoals):
    """Goals of a point mass whose second action opens and closes a hand."""

    hand_actions = (1,)


def test_a_touch_may_end_the_approaches_of_an_episode() -> None:
    policy = linear_policy([float(torch.atanh(torch.tensor(THEIRS)))] * 2)
    config = ContactConfig(
        enabled=True, share=1.0, radius_m=0.05, again_m=1.0, around_share=0.0, hand_over=0.4
    )
    over = []
    for seed in range(300):
        exploring = Explorer(NO_NOISE, ContactPolicy(policy, PointMassGoals(), config, rests=False))
        exploring.begin()
        assert taken_over(exploring, 2, OFF_RADIUS, seed) == 1.0
        taken_over(exploring, 1, 0.0, seed)  # the touch
        over.append(taken_over(exploring, 5, OFF_RADIUS, seed))
    assert set(over) == {0.0, 1.0}
    assert np.mean(over) == pytest.approx(0.6, abs=0.08)


def with_hand(around_share: float) -> ContactPolicy:
    config = ContactConfig(
        enabled=True, share=1.0, radius_m=0.05, again_m=0.1, hand_ticks=3, around_share=around_share
    )
    return ContactPolicy(linear_policy(goal_gain=1.0), HandGoals(), config, rests=False)


def test_the_hand_is_open_on_the_way_to_the_object_and_has_time_to_move() -> None:
    exploring, rng, mine = (
        Explorer(NO_NOISE, with_hand(0.0)),
        generator(0),
        torch.full((1, 2), MINE),
    )
    exploring.begin()
    moves = []
    for approach in range(2):
        place = at(0.15, mark_m=0.2 * approach)  # the object was pushed
        acts = torch.cat([exploring.act(place, mine, rng) for _ in range(6)])
        assert (acts[:, 1] == 1.0).all()
        moves.append(acts[:, 0].tolist())
    assert moves[0] == pytest.approx([-np.tanh(0.15)] * 6)  # no wait before the first leg
    assert moves[1] == pytest.approx([0.0] * 3 + [-np.tanh(0.15)] * 3, abs=1e-4)


def test_on_the_way_to_a_point_the_hand_has_one_command_without_noise() -> None:
    noisy = ExplorationConfig(noise_std=0.2, random_fraction=0.3)
    rng, mine, commands = generator(0), torch.full((1, 2), MINE), []
    for _ in range(100):
        exploring = Explorer(noisy, with_hand(1.0))
        hands = {float(exploring.act(at(5.0), mine, rng)[0, 1]) for _ in range(5)}
        assert hands in ({1.0}, {-1.0})
        commands.append(hands.pop())
    assert 30 < commands.count(1.0) < 70


def test_no_noise_is_added_while_the_hand_moves() -> None:
    noisy = ExplorationConfig(noise_std=0.2, random_fraction=0.3)
    exploring, rng, mine = Explorer(noisy, with_hand(0.0)), generator(0), torch.full((1, 2), MINE)
    exploring.begin()
    exploring.act(at(0.5), mine, rng)
    acts = torch.cat([exploring.act(at(0.04), mine, rng) for _ in range(3)])  # it is touched
    assert (acts[:, 0] == 0.0).all()
    assert abs(float(exploring.act(at(0.04), mine, rng)[0, 0]) + np.tanh(0.04)) > 1e-3


@pytest.mark.parametrize("rests", [True, False])
def test_it_explores_in_its_share_of_the_episodes_once_it_rests(rests: bool) -> None:
    policy = linear_policy([float(torch.atanh(torch.tensor(THEIRS)))] * 2)
    config = ContactConfig(enabled=True, share=1.0, episodes=0.3, radius_m=0.05)
    exploring = Explorer(NO_NOISE, ContactPolicy(policy, PointMassGoals(), config, rests=rests))
    shares = []
    for seed in range(400):
        exploring.begin()
        shares.append(taken_over(exploring, 3, OFF_RADIUS, seed))
    assert set(shares) == ({0.0, 1.0} if rests else {1.0})
    assert np.mean(shares) == pytest.approx(0.3 if rests else 1.0, abs=0.08)


def test_a_point_around_the_object_is_not_below_it() -> None:
    class InSpace(PointMassGoals):
        effector_entries = (0, 1, 2)  # type: ignore[assignment]

    heights, mine = [], torch.zeros(1, 2)

    class Spy(ContactPolicy):
        def act(self, observation: torch.Tensor, place: torch.Tensor) -> torch.Tensor:
            heights.append(float(place[0, 2]))
            return mine

    config = ContactConfig(enabled=True, share=1.0, around_share=1.0, around_m=0.1)

    class Flat(InSpace):
        def object_position(self, observation: torch.Tensor) -> torch.Tensor:
            return torch.zeros(1, 3)

        def effector_position(self, observation: torch.Tensor) -> torch.Tensor:
            return torch.ones(1, 3)

    exploring, rng = (
        Explorer(NO_NOISE, Spy(linear_policy(), Flat(), config, rests=False)),
        generator(),
    )
    for _ in range(200):
        exploring.begin()
        exploring.act(at(1.0), mine, rng)
    assert 0.0 <= min(heights) < 0.01
    assert 0.09 < max(heights) <= 0.1


def test_its_actions_get_the_same_noise_as_the_policys() -> None:
    noisy = ExplorationConfig(noise_std=0.2, random_fraction=0.3)
    exploring, rng = explorer(1.0, noisy), generator(3)
    acts = torch.cat([exploring.act(at(1.0), torch.zeros(1, 2), rng) for _ in range(500)])
    expected = explore(torch.full((20_000, 2), THEIRS), noisy, generator(4))
    assert acts.mean(0).tolist() == pytest.approx(expected.mean(0).tolist(), abs=0.08)
    assert acts.std(0).tolist() == pytest.approx(expected.std(0).tolist(), abs=0.06)


def test_without_contact_exploration_is_noise_alone() -> None:
    noisy = ExplorationConfig(noise_std=0.2, random_fraction=0.3)
    exploring, one, other = Explorer(noisy), generator(1), generator(1)
    exploring.begin()
    for step in range(50):
        action = torch.full((1, 2), step / 50)
        expected = explore(action, noisy, other)
        assert torch.equal(exploring.act(at(0.0), action, one), expected)


def noise(std: float, random: float) -> ExplorationConfig:
    return ExplorationConfig(noise_std=std, random_fraction=random)


@settings(deadline=None, max_examples=50)
@given(st.floats(0, 50), st.floats(0, 1), st.integers(0, 2**31))
def test_explored_actions_stay_within_bounds(std: float, random: float, seed: int) -> None:
    rng = generator(seed)
    action = 2 * torch.rand(64, 4, generator=rng) - 1
    explored = explore(action, noise(std, random), rng)
    assert explored.shape == action.shape
    assert explored.abs().max() <= 1


def test_without_noise_and_random_actions_nothing_changes() -> None:
    action = torch.tanh(torch.randn(50, 4, generator=generator()))
    assert torch.equal(explore(action, NO_NOISE, generator(1)), action)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_share_of_whole_actions_is_replaced_by_uniform_ones(share: float) -> None:
    action = torch.full((20_000, 4), 0.25)
    explored = explore(action, noise(0.0, share), generator())
    changed = explored != action
    assert torch.equal(changed.all(-1), changed.any(-1))
    assert float(changed[:, 0].float().mean()) == pytest.approx(share, abs=0.015)
    if share:
        replaced = explored[changed[:, 0]].flatten()
        counts = torch.histc(replaced, bins=10, min=-1, max=1)
        assert counts.sum() == len(replaced)
        assert deviation(counts, torch.ones(10)) < 4


def test_noise_is_gaussian_of_the_given_deviation_around_the_action() -> None:
    action = torch.tensor([[0.0, 0.3]]).expand(50_000, 2)
    disturbed = explore(action, noise(0.2, 0.0), generator()) - action
    assert disturbed.mean(0).tolist() == pytest.approx([0.0, 0.0], abs=0.005)
    assert disturbed.std(0).tolist() == pytest.approx([0.2, 0.2], rel=0.02)
    within = (disturbed.abs() < 0.2).float().mean()
    assert float(within) == pytest.approx(0.683, abs=0.01)
