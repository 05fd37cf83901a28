"""The second policy: learning to reach the object, end of training, resuming."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.contact.approach import ContactPolicy
from iher_robot.learning.contact.learner import TOUCH_WINDOW, ContactLearner
from iher_robot.learning.contact.model import EffectorGoals, effector_distance
from iher_robot.learning.episode import Episode
from iher_robot.learning.replay import EpisodeReplay
from tests.learning.fakes import CPU, replay_of, same, saved_and_loaded
from tests.learning.point_mass import MARK, SHAPES, STEP, PointMassGoals, observe, rollout
from tests.learning.small_learner import new, quick, real

RADIUS_M = 0.05
DDPG = {"hidden": (64, 64), "batch_size": 128, "gamma": 0.9, "actor_lr": 3e-3, "critic_lr": 3e-3}


def config(**contact: Any) -> LearnerConfig:
    settings = {"enabled": True, "radius_m": RADIUS_M, "hidden": (64, 64)} | contact
    return quick(ddpg=DDPG, contact=settings)


def contact_learner(seed: int = 0, **contact: Any) -> ContactLearner:
    return ContactLearner(SHAPES, PointMassGoals(), config(**contact), seed=seed, device=CPU)


def random_episodes(count: int, seed: int = 0) -> list[Episode]:
    rng = np.random.default_rng(seed)
    return [rollout(rng) for _ in range(count)]


def fed(learner: ContactLearner, count: int = 40) -> EpisodeReplay:
    replay = replay_of(random_episodes(count))
    learner.add_real(replay, random_episodes(count))
    return replay


def towards_mark(policy: ContactPolicy, observation: torch.Tensor) -> torch.Tensor:
    return policy.act(observation, PointMassGoals().object_position(observation))


def touches(policy: ContactPolicy | None, episodes: int = 40) -> float:
    """Share of episodes, of twice the usual length, that reach the mark."""
    rng, touched = np.random.default_rng(5), 0
    for _ in range(episodes):
        position, velocity = rng.uniform(-0.1, 0.1, size=2), np.zeros(2)
        for _ in range(2 * SHAPES.episode_ticks):
            observation = torch.as_tensor(observe(position, velocity), dtype=torch.float32)[None]
            action = rng.uniform(-1, 1, size=2)
            if policy is not None:
                action = towards_mark(policy, observation)[0].numpy()
            velocity = STEP * action
            position = position + velocity
            if np.linalg.norm(position - MARK) < RADIUS_M:
                touched += 1
                break
    return touched / episodes


def approaching(touch: bool) -> Episode:
    """An episode that passes the mark, or does not move."""
    episode = random_episodes(1)[0]
    places = np.zeros((SHAPES.episode_ticks + 1, 2))
    if touch:
        places[4] = MARK + np.array([0.9 * RADIUS_M, 0.0])
    episode.observations[:] = [observe(place, np.zeros(2)) for place in places]
    return episode


def test_it_learns_to_bring_the_effector_to_the_object_by_hindsight_alone() -> None:
    learner = contact_learner()
    untrained = learner.snapshot(CPU)
    replay = fed(learner)
    assert sum(learner.touched(episode) for episode in random_episodes(40)) == 0
    learner.learn(replay, 400, None)
    assert touches(learner.snapshot(CPU)) > 0.8
    assert touches(untrained) < 0.3
    assert touches(None) < 0.3


def test_the_goals_reward_is_that_of_the_radius() -> None:
    goals = EffectorGoals(PointMassGoals(), RADIUS_M)
    desired = torch.zeros(3, 2)
    achieved = torch.tensor([[0.0, 0.049], [0.051, 0.0], [0.04, 0.04]])
    assert goals.compute_reward(achieved, desired).tolist() == [0.0, -1.0, -1.0]
    observation = torch.as_tensor(random_episodes(1)[0].observations)
    assert torch.equal(goals.achieved_goal(observation), observation[:, :2])
    expected = np.linalg.norm(observation[:, :2].numpy() - MARK, axis=-1)
    np.testing.assert_allclose(effector_distance(PointMassGoals(), observation), expected)


def test_stored_intrinsic_rewards_are_ignored() -> None:
    losses = []
    for reward in (0.0, 0.8):
        learner = contact_learner()
        replay = fed(learner)
        replay.store_intrinsic(*replay.all_indices(), torch.tensor(reward))
        losses.append(learner.learn(replay, 3, None).means())
    assert losses[0] == losses[1]


def test_training_ends_once_enough_of_the_newest_episodes_touched() -> None:
    learner = contact_learner(until_touched=0.9)
    replay = fed(learner, 4)

    def newest(*touching: bool) -> bool:
        learner.add_real(replay, [approaching(touch) for touch in touching])
        before = learner.ddpg.state_dict()
        metrics = learner.learn(replay, 1, None).means()
        worked = not same(before, learner.ddpg.state_dict())
        assert worked is bool(metrics) is not learner.rests
        return not worked

    assert not newest(*[True] * (TOUCH_WINDOW - 5))  # of 4 + 15
    assert not newest(True)  # 16 of 20
    assert newest(*[True] * 2)  # 18 of 20
    assert newest(*[False] * 20)


def test_a_snapshot_is_independent_of_later_updates() -> None:
    learner = contact_learner()
    replay = fed(learner, 10)
    snapshot = learner.snapshot(CPU)
    observation = torch.as_tensor(random_episodes(1)[0].observations, dtype=torch.float32)
    before = towards_mark(snapshot, observation)
    learner.learn(replay, 20, None)
    fed(learner, 10)
    assert torch.equal(towards_mark(snapshot, observation), before)
    assert not torch.allclose(towards_mark(learner.snapshot(CPU), observation), before)


def test_a_restored_contact_learner_continues_like_the_original() -> None:
    original = contact_learner()
    replay = fed(original, TOUCH_WINDOW)
    original.learn(replay, 5, None)
    state = saved_and_loaded(original.state_dict())
    restored = contact_learner(seed=7)
    restored.load_state_dict(state)
    for learner in (original, restored):
        learner.add_real(replay, [approaching(touch=True)] * 17)
        learner.learn(replay, 5, None)
        learner.add_real(replay, [approaching(touch=True)])
    assert original.rests
    assert restored.rests
    assert same(original.state_dict(), restored.state_dict())
    assert original.state_dict()["ddpg"]["updates"] == 10


@pytest.mark.parametrize("per_step", [0.25, 1.0])
def test_its_updates_are_proportional_to_the_fresh_steps(per_step: float) -> None:
    learner = new(config(updates_per_step=per_step), contact_model=PointMassGoals())
    assert learner.contact is not None
    for epoch, count in ((1, 4), (2, 2)):
        learner.add_real(real(epoch, count))
        assert "contact_critic_loss" in learner.learn()
    expected = per_step * 6 * SHAPES.episode_ticks
    assert learner.contact.state_dict()["ddpg"]["updates"] == expected


def test_resuming_a_learner_with_contact_equals_no_interruption() -> None:
    settings = quick(
        contact={"enabled": True, "updates_per_step": 0.5},
        ddpg={"critics": 3, "target_subset": 2, "actor_period": 2, "target_update": "update"},
    )
    whole = new(settings, contact_model=PointMassGoals())
    for epoch in (1, 2):
        whole.add_real(real(epoch))
        whole.learn()
    state = saved_and_loaded(whole.state_dict())
    resumed = new(settings, seed=9, contact_model=PointMassGoals())
    resumed.load_state_dict(state, [real(1), real(2)])
    for learner in (whole, resumed):
        learner.add_real(real(3))
        learner.learn()
    assert whole.contact is not None
    assert resumed.contact is not None
    assert same(whole.contact.state_dict(), resumed.contact.state_dict())
    assert same(whole.ddpg.state_dict(), resumed.ddpg.state_dict())
    assert same(whole.policy.snapshot(), resumed.policy.snapshot())


def test_the_explorer_goes_to_the_object_only_if_contact_is_enabled() -> None:
    observation = torch.as_tensor(observe(np.zeros(2), np.zeros(2)), dtype=torch.float32)[None]
    quiet = {"noise_std": 0.0, "random_fraction": 0.0}
    for enabled in (False, True):
        settings = quick(contact={"enabled": enabled, "share": 1.0}, exploration=quiet)
        learner = new(settings, contact_model=PointMassGoals())
        mine = torch.full((1, 2), 0.25)
        act = learner.explorer().act(observation, mine, torch.Generator().manual_seed(0))
        assert torch.equal(act, mine) is not enabled
        if learner.contact is not None:
            assert torch.equal(act, towards_mark(learner.contact.snapshot(CPU), observation))
