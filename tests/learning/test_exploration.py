"""Who acts while exploring: the policy, or until the touch the one that goes to the object."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from iher_robot.learning.config import ContactConfig, ExplorationConfig
from iher_robot.learning.contact.approach import LEG_TICKS, ContactPolicy
from iher_robot.learning.exploration import Explorer, explore
from tests.learning.point_mass import MARK, PointMassGoals, observe
from tests.learning.stand_ins import NO_NOISE, generator, linear_policy

MINE, THEIRS = 0.25, 0.9
OFF_RADIUS = 0.06


def explorer(share: float, exploration: ExplorationConfig = NO_NOISE) -> Explorer:
    """The second policy's actions are THEIRS in every entry."""
    policy = linear_policy([float(torch.atanh(torch.tensor(THEIRS)))] * 2)
    config = ContactConfig(enabled=True, share=share, radius_m=0.05)
    return Explorer(exploration, ContactPolicy(policy, PointMassGoals(), config, rests=False))


def roundabout(again_m: float | None = None) -> Explorer:
    """One whose approaches all go by a point around the object, 1 m away at most along an axis."""
    config = ContactConfig(
        enabled=True, share=1.0, radius_m=0.05, around_share=1.0, around_m=1.0, again_m=again_m
    )
    return Explorer(
        NO_NOISE, ContactPolicy(linear_policy(goal_gain=1.0), PointMassGoals(), config, rests=False)
    )


def at(*offset_m: float, mark_m: float = 0.0) -> torch.Tensor:
    """Observation so far beside the mark, which was moved along x."""
    away = np.array([*offset_m, 0.0])[:2]
    position = MARK + np.array([mark_m, 0.0]) + away
    observation = observe(position, position * 0)
    observation[4:6] = away
    return torch.as_tensor(observation, dtype=torch.float32)[None]


def place_of(act: torch.Tensor, offset_m: tuple[float, float]) -> np.ndarray:
    """Where, from the mark, a policy of gain 1 goes that acts so at the offset."""
    return np.asarray(torch.atanh(act[0]).numpy() + offset_m)


def taken_over(explorer: Explorer, steps: int, distance_m: float, seed: int = 0) -> float:
    """Share of the steps that the second policy takes, all at one place."""
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


def test_it_never_acts_from_the_touch_on_until_the_next_episode_begins() -> None:
    exploring = explorer(1.0)
    for episode in range(3):
        exploring.begin()
        assert taken_over(exploring, 5, OFF_RADIUS, episode) == 1.0
        assert taken_over(exploring, 1, 0.04, episode) == 0.0
        assert taken_over(exploring, 20, OFF_RADIUS, episode) == 0.0


def test_an_object_that_moved_was_touched() -> None:
    exploring = explorer(1.0)
    rng, mine = generator(), torch.full((1, 2), MINE)
    for moved, theirs in ((0.0, True), (0.009, True), (0.011, False), (0.0, False)):
        act = exploring.act(at(OFF_RADIUS, mark_m=moved), mine, rng)
        assert torch.equal(act, mine) is not theirs, moved


def test_by_a_point_around_the_object_first_and_then_to_it() -> None:
    mine, drawn = torch.full((1, 2), MINE), []
    for seed in range(200):
        exploring, rng = roundabout(), generator(seed)
        exploring.begin()
        place = place_of(exploring.act(at(1.2), mine, rng), (1.2, 0.0))
        drawn.append(place.copy())
        # What is touched or pushed on the way there does not end it.
        act = exploring.act(at(0.0, mark_m=0.3), mine, rng)
        place[0] -= 0.3  # where it is from the mark now
        np.testing.assert_allclose(place_of(act, (0.0, 0.0)), place, atol=1e-4)
        # There, it goes on to the object, until that moves.
        act = exploring.act(at(*place, mark_m=0.3), mine, rng)
        if np.linalg.norm(place) > 0.05:
            np.testing.assert_allclose(place_of(act, tuple(place)), 0.0, atol=1e-4)
            act = exploring.act(at(0.5, mark_m=0.305), mine, rng)
            np.testing.assert_allclose(place_of(act, (0.5, 0.0)), 0.0, atol=1e-4)
        assert torch.equal(exploring.act(at(0.5, mark_m=0.32), mine, rng), mine)
    assert np.abs(drawn).max(0) == pytest.approx([1.0, 1.0], abs=0.05)
    assert np.mean(drawn, axis=0) == pytest.approx([0.0, 0.0], abs=0.15)


def test_it_approaches_anew_after_each_push_where_it_is_told_to() -> None:
    exploring, rng, mine = roundabout(again_m=0.1), generator(3), torch.full((1, 2), MINE)
    exploring.begin()
    places = []
    for pushes in range(5):
        mark_m = 0.11 * pushes
        place = place_of(exploring.act(at(1.2, mark_m=mark_m), mine, rng), (1.2, 0.0))
        places.append(tuple(place.round(3)))
        act = exploring.act(at(*place, mark_m=mark_m), mine, rng)
        np.testing.assert_allclose(place_of(act, tuple(place)), 0.0, atol=1e-4)
        act = exploring.act(at(0.2, mark_m=mark_m + 0.09), mine, rng)  # not yet far enough
        np.testing.assert_allclose(place_of(act, (0.2, 0.0)), 0.0, atol=1e-4)
    assert len(set(places)) == 5


def test_a_point_that_is_not_reached_is_given_up() -> None:
    exploring, rng, mine = roundabout(), generator(3), torch.full((1, 2), MINE)
    exploring.begin()
    places = [place_of(exploring.act(at(1.2), mine, rng), (1.2, 0.0)) for _ in range(LEG_TICKS + 2)]
    assert all(np.abs(place).max() > 0.05 for place in places[:LEG_TICKS])
    np.testing.assert_allclose(places[-1], 0.0, atol=1e-4)


class HandGoals(PointMassGoals):
    """Its second action opens and closes a hand."""

    hand_actions = (1,)


def test_at_a_touch_it_may_hand_over_to_the_policy_for_good() -> None:
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


def test_a_hand_is_open_on_the_way_to_the_object_and_waited_for_there() -> None:
    exploring, rng, mine = (
        Explorer(NO_NOISE, with_hand(0.0)),
        generator(0),
        torch.full((1, 2), MINE),
    )
    exploring.begin()
    moves = []
    for approach in range(2):
        place = at(0.15, mark_m=0.2 * approach)  # it was pushed, or jumps
        acts = torch.cat([exploring.act(place, mine, rng) for _ in range(6)])
        assert (acts[:, 1] == 1.0).all()
        moves.append(acts[:, 0].tolist())
    assert moves[0] == pytest.approx([-np.tanh(0.15)] * 6)  # there is nothing to wait for yet
    assert moves[1] == pytest.approx([0.0] * 3 + [-np.tanh(0.15)] * 3, abs=1e-4)


def test_from_the_object_a_hand_is_told_one_thing_and_no_noise_changes_it() -> None:
    noisy = ExplorationConfig(noise_std=0.2, random_fraction=0.3)
    rng, mine, told = generator(0), torch.full((1, 2), MINE), []
    for _ in range(100):
        exploring = Explorer(noisy, with_hand(1.0))
        hands = {float(exploring.act(at(5.0), mine, rng)[0, 1]) for _ in range(5)}
        assert hands in ({1.0}, {-1.0})
        told.append(hands.pop())
    assert 30 < told.count(1.0) < 70


def test_while_a_hand_moves_nothing_is_disturbed() -> None:
    noisy = ExplorationConfig(noise_std=0.2, random_fraction=0.3)
    exploring, rng, mine = Explorer(noisy, with_hand(0.0)), generator(0), torch.full((1, 2), MINE)
    exploring.begin()
    exploring.act(at(0.5), mine, rng)
    acts = torch.cat([exploring.act(at(0.04), mine, rng) for _ in range(3)])  # it is touched
    assert (acts[:, 0] == 0.0).all()
    assert abs(float(exploring.act(at(0.04), mine, rng)[0, 0]) + np.tanh(0.04)) > 1e-3


@pytest.mark.parametrize("rests", [True, False])
def test_it_has_a_part_in_its_share_of_the_episodes_while_it_rests(rests: bool) -> None:
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


def test_its_actions_are_disturbed_as_those_of_the_policy() -> None:
    noisy = ExplorationConfig(noise_std=0.2, random_fraction=0.3)
    exploring, rng = explorer(1.0, noisy), generator(3)
    acts = torch.cat([exploring.act(at(1.0), torch.zeros(1, 2), rng) for _ in range(500)])
    expected = explore(torch.full((20_000, 2), THEIRS), noisy, generator(4))
    assert acts.mean(0).tolist() == pytest.approx(expected.mean(0).tolist(), abs=0.08)
    assert acts.std(0).tolist() == pytest.approx(expected.std(0).tolist(), abs=0.06)


def test_without_contact_it_is_the_disturbance_alone() -> None:
    noisy = ExplorationConfig(noise_std=0.2, random_fraction=0.3)
    exploring, one, other = Explorer(noisy), generator(1), generator(1)
    exploring.begin()
    for step in range(50):
        action = torch.full((1, 2), step / 50)
        expected = explore(action, noisy, other)
        assert torch.equal(exploring.act(at(0.0), action, one), expected)
