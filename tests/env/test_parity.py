"""Our environments against the live official ones, to the last bit.

Constants drift with MuJoCo's version, so nothing here is a recorded number.
"""

from __future__ import annotations

from collections.abc import Iterator

import gymnasium as gym
import gymnasium_robotics
import numpy as np
import pytest

from drivers.mujoco import MujocoDriver
from iher_robot.env.goal_env import GoalRobotEnv, make_env

gym.register_envs(gymnasium_robotics)

OFFICIAL = {
    "reach": "FetchReach-v4",
    "push": "FetchPush-v4",
    "pick_and_place": "FetchPickAndPlace-v4",
    "slide": "FetchSlide-v4",
}
EPISODES = 20
TICKS = 50

Pair = tuple[gym.Env, GoalRobotEnv]
Observation = dict[str, np.ndarray]


@pytest.fixture(scope="module", params=list(OFFICIAL))
def pair(request: pytest.FixtureRequest) -> Iterator[Pair]:
    official = gym.make(OFFICIAL[request.param])
    with make_env(request.param, actuation="mocap") as ours:
        yield official, ours
    official.close()


def assert_equal(official: Observation, ours: Observation) -> None:
    assert official.keys() == ours.keys()
    for key, value in official.items():
        assert value.dtype == ours[key].dtype
        # Bytes, not values: -0.0 and 0.0 must agree, too.
        assert value.tobytes() == ours[key].tobytes(), f"{key}: {value} is not {ours[key]}"


def scripted_action(obs: np.ndarray, episode: int, tick: int, rng: np.random.Generator):  # type: ignore[no-untyped-def]
    """Random in a third of the episodes, else towards the object, from above or through it."""
    action = rng.uniform(-1.0, 1.0, 4)
    if len(obs) == 25 and episode % 3:
        target = obs[3:6].copy()
        if episode % 3 == 1:  # grasp and lift
            action[3] = 1.0 if tick < 20 else -1.0
            target[2] += 0.0 if tick < 30 else 0.2
        action[:3] = np.clip((target - obs[:3]) * 20.0, -1.0, 1.0) + 0.2 * action[:3]
    # Both precisions, and beyond the action space: each rounds and cuts in its own way.
    return (1.1 * action).astype(np.float32 if episode % 2 else np.float64)


def test_whole_episodes_are_equal_to_the_bit(pair: Pair) -> None:
    official, ours = pair
    rng = np.random.default_rng(0)
    moved = lifted = 0
    for episode in range(EPISODES):
        expected, _ = official.reset(seed=100 + episode)
        start, _ = ours.reset(seed=100 + episode)
        assert_equal(expected, start)
        highest = 0.0
        for tick in range(TICKS):
            action = scripted_action(expected["observation"], episode, tick, rng)
            expected, reward, _, _, info = official.step(action)
            obs, our_reward, terminated, truncated, our_info = ours.step(action)
            assert_equal(expected, obs)
            assert our_reward == reward
            assert our_info["is_success"] == info["is_success"]
            assert our_info["tick_valid"]
            assert not terminated
            assert not truncated
            highest = max(highest, expected["achieved_goal"][2] - start["achieved_goal"][2])
        displacement = expected["achieved_goal"] - start["achieved_goal"]
        moved += bool(np.linalg.norm(displacement[:2]) > 0.02)
        lifted += bool(highest > 0.05)
    # Free space alone would prove little.
    assert moved >= 5
    if ours.task.name == "pick_and_place":
        assert lifted >= 3


def test_starts_and_goals_are_the_same_draws_without_a_new_seed(pair: Pair) -> None:
    official, ours = pair
    official.reset(seed=7)
    ours.reset(seed=7)
    for _ in range(5):
        assert_equal(official.reset()[0], ours.reset()[0])


def test_an_episode_continues_to_the_bit_from_the_official_state(pair: Pair) -> None:
    official, ours = pair
    rng = np.random.default_rng(5)
    expected, _ = official.reset(seed=1)
    ours.reset(seed=2)  # another start, which the state below replaces
    for tick in range(15):
        official.step(scripted_action(expected["observation"], 1, tick, rng))
    assert isinstance(ours.driver, MujocoDriver)
    ours.driver.restore(official.unwrapped.data)  # type: ignore[attr-defined]
    ours._state = ours.driver.read()
    for tick in range(15, 40):
        action = scripted_action(expected["observation"], 1, tick, rng)
        expected = official.step(action)[0]
        obs = ours.step(action)[0]
        for key in ("observation", "achieved_goal"):
            assert expected[key].tobytes() == obs[key].tobytes()


def test_rewards_equal_the_official_function_on_batches(pair: Pair) -> None:
    official, ours = pair
    rng = np.random.default_rng(3)
    achieved = rng.normal(size=(500, 3))
    desired = achieved + rng.normal(scale=0.03, size=(500, 3))
    expected = official.unwrapped.compute_reward(achieved, desired, {})  # type: ignore[attr-defined]
    rewards = ours.compute_reward(achieved, desired, {})
    assert 50 < (rewards == 0.0).sum() < 450
    np.testing.assert_array_equal(rewards, expected)


def test_completing_a_real_observation_changes_nothing(pair: Pair) -> None:
    _, ours = pair
    obs = ours.reset(seed=4)[0]["observation"]
    for _ in range(10):
        obs = ours.step(np.array([1.0, -1.0, -0.5, 1.0]))[0]["observation"]
        assert ours.task.goal_model.complete(obs).tobytes() == obs.tobytes()


def test_starts_and_goals_of_a_batch_stay_where_the_official_ones_are(pair: Pair) -> None:
    official, ours = pair
    obs = ours.reset(seed=0)[0]["observation"]
    batch = ours.task.goal_model.sample_goal(
        np.random.default_rng(0), np.repeat(obs[None], 500, axis=0)
    )
    single = np.stack([official.reset(seed=seed)[0]["desired_goal"] for seed in range(60)])
    # Uniform regions: the batch's box contains nearly all of the official draws, and is no larger.
    slack = 0.02
    assert (single.min(0) >= batch.min(0) - slack).all()
    assert (single.max(0) <= batch.max(0) + slack).all()
    np.testing.assert_allclose(batch.mean(0), single.mean(0), atol=0.08)
