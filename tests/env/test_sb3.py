"""An unmodified Stable-Baselines3 agent with hindsight trains on the environment."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from iher_robot.env.goal_env import make_env

pytest.importorskip("stable_baselines3", reason="comes with the bench extra")

from gymnasium.wrappers import TimeLimit
from stable_baselines3 import DDPG, HerReplayBuffer
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.policies import ContinuousCritic
from stable_baselines3.common.type_aliases import DictReplayBufferSamples

TRAINING_TICKS = 1200


@pytest.fixture(scope="module", autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


@pytest.mark.parametrize("task", ["reach", "push"])
def test_the_environment_passes_their_checks(task: str) -> None:
    with make_env(task) as env:
        check_env(env, warn=True, skip_render_check=True)


def make_agent() -> DDPG:
    env = TimeLimit(make_env("reach"), max_episode_steps=50)
    return DDPG(
        "MultiInputPolicy",
        env,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
        action_noise=NormalActionNoise(np.zeros(4), 0.2 * np.ones(4)),
        policy_kwargs={"net_arch": [64, 64]},
        learning_starts=150,
        batch_size=128,
        gamma=0.9,
        tau=0.05,
        seed=0,
        device="cpu",
    )


@pytest.fixture(scope="module")
def agent() -> DDPG:
    return make_agent().learn(TRAINING_TICKS)


def sample(agent: DDPG) -> DictReplayBufferSamples:
    assert isinstance(agent.replay_buffer, HerReplayBuffer)
    batch = agent.replay_buffer.sample(1024)
    assert isinstance(batch, DictReplayBufferSamples)
    return batch


def test_relabelled_rewards_are_those_of_the_environment(agent: DDPG) -> None:
    assert agent.replay_buffer is not None
    assert agent.replay_buffer.size() == TRAINING_TICKS
    batch = sample(agent)
    with make_env("reach") as env:
        expected = env.compute_reward(
            batch.next_observations["achieved_goal"].numpy(),
            batch.observations["desired_goal"].numpy(),
            {},
        )
    np.testing.assert_array_equal(batch.rewards.numpy().ravel(), expected)
    # Hindsight finds goals that were reached; the episodes themselves hardly do at first.
    assert 0.1 < (expected == 0.0).mean() < 0.9


def advantage_of_reached_goals(critic: ContinuousCritic, batch: DictReplayBufferSamples) -> float:
    """Return how much higher the critic values transitions that reach their goal."""
    with torch.no_grad():
        (value,) = critic(batch.observations, batch.actions)
    reached = batch.rewards == 0.0
    return float(value[reached].mean() - value[~reached].mean())


def test_the_agent_learns_which_goals_are_reached(agent: DDPG) -> None:
    batch = sample(agent)
    assert abs(advantage_of_reached_goals(make_agent().critic, batch)) < 0.1
    assert advantage_of_reached_goals(agent.critic, batch) > 0.5
