"""Observers of an episode: what records, charges, logs, films or shows its ticks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, SupportsFloat

import numpy as np
from numpy.typing import NDArray

from iher_robot.env.goal_env import EpisodeAborted, Info, Observation
from iher_robot.env.tick import Tick

Action = NDArray[np.floating]


class EpisodeEnv(Protocol):
    """The part of a goal environment that an episode needs; `GoalRobotEnv` has it."""

    def reset(self, *, seed: int) -> tuple[Observation, Info]:
        """Bring the robot to a start and return its observation."""

    def step(self, action: Action, /) -> tuple[Observation, SupportsFloat, bool, bool, Info]:
        """Run one control tick."""

    def hold(self, after: BaseException | None = None) -> None:
        """Hold and disarm the robot."""

    def render(self) -> Any:
        """Return a picture, where the environment renders any."""


@dataclass(frozen=True, eq=False)
class EpisodeStart:
    """Start of an episode: the robot stands there, and no tick has begun.

    Attributes:
        env: The environment.
        observation: Observation of the reset.
        policy_source: Index of the replay source that the policy is conditioned on.
    """

    env: EpisodeEnv
    observation: Observation
    policy_source: int


@dataclass(frozen=True, eq=False)
class Transition:
    """One control tick of an episode, after it has ended.

    Attributes:
        observation: Observation before the tick.
        action: Action that the policy requested. ``(action_dim,)``
        next_observation: Observation after the tick.
        info: Info of the environment's step; on a robot it holds the `Tick`.
    """

    observation: Observation
    action: Action
    next_observation: Observation
    info: Mapping[str, Any]

    @property
    def tick(self) -> Tick:
        """The control tick as the robot reported it."""
        tick: Tick = self.info["tick"]
        return tick

    @property
    def success(self) -> bool:
        """Whether the goal is met after the tick."""
        return bool(self.info["is_success"])


class EpisodeObserver:
    """Follows one episode of `run_episode`; every hook does nothing unless it is overridden.

    An error that a hook raises ends the episode; the robot is held and disarmed.
    """

    def start(self, start: EpisodeStart) -> None:
        """Called after the reset, before the first tick."""

    def before_tick(self, observation: Observation, action: Action) -> None:
        """Called when the action is chosen, before the robot gets it.

        Args:
            observation: Observation that the action answers.
            action: Action that the policy requested. ``(action_dim,)``
        """

    def after_tick(self, transition: Transition) -> None:
        """Called after each tick that returned."""

    def abort(self, error: EpisodeAborted) -> None:
        """Called when the episode cannot go on, but the run can."""

    def end(self, error: BaseException | None) -> None:
        """Called once, however the episode ends, also where it never started.

        The robot is held and disarmed, unless that is the error.

        Args:
            error: The error that ends the episode and its caller; None after an abort.
        """
