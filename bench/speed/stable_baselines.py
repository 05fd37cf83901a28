"""Contender Stable-Baselines3: DDPG with ``HerReplayBuffer``."""

from __future__ import annotations

from collections.abc import Sequence

import gymnasium as gym
import torch
from stable_baselines3 import DDPG, HerReplayBuffer
from stable_baselines3.common.logger import configure

from bench.speed.comparison import Contender
from bench.speed.official import make_official
from bench.speed.precision import Precision
from bench.speed.settings import Settings
from bench.speed.timing import seconds_of

NAME = "Stable-Baselines3"
STORED = 3_200
NEVER = 10**9


class Agent:
    """An agent with stored episodes of random actions.

    Args:
        algorithm: Algorithm class; sbx has the same interface.
        policy: Its policy.
        settings: Settings of the run.
        hidden: Widths of the hidden layers of actor and critic.
        device: Device of the agent.
    """

    def __init__(
        self,
        algorithm: type[DDPG],
        policy: str | type,
        settings: Settings,
        hidden: Sequence[int],
        device: str,
    ) -> None:
        self._settings = settings
        stored = settings.sized(STORED, 200)
        env: gym.Env = make_official()
        self._agent = algorithm(
            policy,
            env,
            replay_buffer_class=HerReplayBuffer,
            replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
            policy_kwargs={"net_arch": list(hidden)},
            buffer_size=100_000,
            learning_starts=NEVER,
            train_freq=(stored, "step"),
            gamma=0.98,
            tau=0.05,
            seed=0,
            device=device,
        )
        self._agent.learn(stored)
        self._agent.set_logger(configure(None, []))

    def rate(self, batch: int, count: int) -> float:
        """Updates per second."""
        seconds = seconds_of(
            lambda: self._agent.train(count, batch_size=batch), self._settings.device
        )
        return count / seconds

    def contender(self, precision: Precision, batch: int, count: int) -> Contender:
        """Contender that takes a number of updates."""

        def measure(_: int) -> float:
            with precision.around_others(self._settings.device):
                return self.rate(batch, count)

        measure(0)  # warm-up: compilation and allocation
        note = "under torch.autocast" if precision.products != torch.float32 else ""
        return Contender(NAME, measure, note)


def agent(settings: Settings, hidden: Sequence[int]) -> Agent:
    """Create and fill the agent."""
    return Agent(DDPG, "MultiInputPolicy", settings, hidden, str(settings.device))
