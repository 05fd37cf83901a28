"""An unmodified Stable-Baselines3 agent learns Reach from an exported dataset alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from iher_robot.datasets.api import export_minari
from iher_robot.datasets.minari import ROOT_VARIABLE
from iher_robot.env.goal_env import GoalRobotEnv, make_env
from tests.run_folders import make_run, record_episode

pytest.importorskip("stable_baselines3", reason="comes with the bench extra")

from stable_baselines3 import TD3, HerReplayBuffer
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

minari = pytest.importorskip("minari", reason="comes with the data extra")
pytest.importorskip("h5py", reason="comes with the data extra")

EPISODES = 60
GRADIENT_STEPS = 1200
JUDGED = 10


@pytest.fixture(scope="module", autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Random episodes of Reach in the folder of a run."""
    folder = tmp_path_factory.mktemp("export")
    with make_env("reach", actuation="mocap") as env:
        make_run(folder / "run", (record_episode(env, seed) for seed in range(EPISODES)))
    export_minari([folder / "run"], dataset="reach-v0", root=folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(ROOT_VARIABLE, str(folder))
        return minari.load_dataset("reach-v0")


def make_agent(dataset: Any) -> tuple[TD3, VecNormalize]:
    """An agent with the dataset as its replay, and inputs scaled by the dataset."""
    env = DummyVecEnv([dataset.recover_environment])
    scaled = VecNormalize(env, training=False, norm_reward=False)
    agent = TD3(
        "MultiInputPolicy",
        scaled,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
        policy_kwargs={"net_arch": [64, 64]},
        buffer_size=EPISODES * 50,
        gamma=0.9,
        tau=0.05,
        seed=0,
        device="cpu",
    )
    agent.set_logger(Logger(folder=None, output_formats=[]))
    assert isinstance(scaled.obs_rms, dict)
    for episode in dataset:
        for name, values in episode.observations.items():
            scaled.obs_rms[name].update(values)
        fill(agent.replay_buffer, episode)
    return agent, scaled


def fill(replay: Any, episode: Any) -> None:
    for step in range(len(episode)):
        before, after = (
            {name: values[None, at] for name, values in episode.observations.items()}
            for at in (step, step + 1)
        )
        ended = episode.terminations[step] | episode.truncations[step]
        info = {"TimeLimit.truncated": bool(episode.truncations[step])}
        action, reward = episode.actions[None, step], episode.rewards[None, step]
        replay.add(before, after, action, reward, np.array([ended]), [info])


def success_rate(agent: TD3, scaled: VecNormalize) -> float:
    (env,) = scaled.unwrapped.get_attr("unwrapped")
    assert isinstance(env, GoalRobotEnv)
    successes = 0.0
    for episode in range(JUDGED):
        observation, info = env.reset(seed=1000 + episode)
        for _ in range(env.episode_ticks):
            scaled_observation = scaled.normalize_obs(observation)
            assert isinstance(scaled_observation, dict)
            action, _ = agent.predict(scaled_observation, deterministic=True)
            observation, _, _, _, info = env.step(action)
        successes += info["is_success"]
    return successes / JUDGED


def test_an_agent_learns_from_the_dataset_alone(
    dataset: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    agent, scaled = make_agent(dataset)
    untrained = success_rate(agent, scaled)

    with monkeypatch.context() as patch:
        for name in ("reset", "step"):
            patch.setattr(GoalRobotEnv, name, None)  # nothing moves while it learns
        agent.train(GRADIENT_STEPS, batch_size=256)

    assert untrained <= 0.3
    assert success_rate(agent, scaled) >= 0.9
