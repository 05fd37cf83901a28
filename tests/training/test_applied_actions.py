"""Where a robot clips, learning from what it applied beats learning from what was asked."""

from __future__ import annotations

import numpy as np
import torch

from iher_robot.env.goal_env import GoalRobotEnv, make_env
from iher_robot.learning.config import DynamicsConfig
from iher_robot.learning.episode import Episode
from iher_robot.learning.goal_model import REAL, Shapes
from iher_robot.learning.imagination.dynamics import DynamicsEnsemble
from iher_robot.learning.replay import EpisodeReplay
from iher_robot.rollout.episode import run_episode
from iher_robot.rollout.recorder import Recorder
from tests.random_actor import RandomActor

CPU = torch.device("cpu")
SHAPES = Shapes(obs_dim=10, goal_dim=3, action_dim=4, episode_ticks=50)


def random_episodes(env: GoalRobotEnv, count: int, seed: int) -> list[Episode]:
    actor, episodes = RandomActor(seed), []
    for index in range(count):
        recorder = Recorder()
        run_episode(env, actor, recorder, seed=100 * seed + index, ticks=50)
        episode = recorder.episode()
        assert episode is not None
        episodes.append(episode)
    return episodes


def replay_of(episodes: list[Episode], *, requested: bool) -> EpisodeReplay:
    replay = EpisodeReplay(SHAPES, capacity=50 * len(episodes), source=REAL, device=CPU)
    for episode in episodes:
        actions = episode.requested_actions if requested else episode.actions
        replay.add(
            torch.as_tensor(episode.observations, dtype=torch.float32)[None],
            torch.as_tensor(actions, dtype=torch.float32)[None],
            torch.as_tensor(episode.desired_goal, dtype=torch.float32)[None],
            epoch=1,
        )
    return replay


def held_out_error_m(fitted: EpisodeReplay, unseen: EpisodeReplay) -> float:
    """Root mean square error of the gripper's predicted displacement."""
    config = DynamicsConfig(members=1, hidden=(128, 128))
    ensemble = DynamicsEnsemble(
        SHAPES, config, generator=torch.Generator().manual_seed(0), device=CPU
    )
    generator = torch.Generator().manual_seed(1)
    ensemble.fit_normalizers(fitted, generator)
    ensemble.train(fitted, 1500, batch_size=256, generator=generator)
    observation, action, following = unseen.steps(*unseen.all_indices())
    delta = ensemble.predict(observation, action)[0]
    error = ensemble.next_observation(observation, delta) - following
    return float(error[:, :3].square().sum(-1).mean().sqrt())


def test_a_model_of_applied_actions_predicts_a_clipping_robot_better() -> None:
    with make_env("reach") as env:
        seen, unseen = random_episodes(env, 30, seed=1), random_episodes(env, 20, seed=2)
    differing = np.mean([np.abs(e.actions - e.requested_actions).max(-1) > 0.1 for e in seen])
    assert differing > 0.3, "the accelerations of the joints cut independent noise often"
    errors = {
        requested: held_out_error_m(
            replay_of(seen, requested=requested), replay_of(unseen, requested=requested)
        )
        for requested in (False, True)
    }
    assert errors[False] < 0.7 * errors[True]
