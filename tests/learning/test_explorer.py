"""Who acts while exploring: the policy, or until the touch the one that goes to the object."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from iher_robot.learning.config import ContactConfig, ExplorationConfig
from iher_robot.learning.contact import ContactPolicy
from iher_robot.learning.explorer import Explorer
from iher_robot.learning.policy import explore
from tests.learning.point_mass import MARK, PointMassGoals, observe
from tests.learning.stand_ins import NO_NOISE, generator, linear_policy

MINE, THEIRS = 0.25, 0.9
OFF_RADIUS = 0.06


def explorer(share: float, exploration: ExplorationConfig = NO_NOISE) -> Explorer:
    """The second policy's actions are THEIRS in every entry."""
    policy = linear_policy([float(torch.atanh(torch.tensor(THEIRS)))] * 2)
    config = ContactConfig(enabled=True, share=share, radius_m=0.05)
    return Explorer(exploration, ContactPolicy(policy, PointMassGoals(), config))


def at(distance_m: float) -> torch.Tensor:
    """Observation so far beside the mark."""
    position = MARK + np.array([distance_m, 0.0])
    return torch.as_tensor(observe(position, position * 0), dtype=torch.float32)[None]


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
