"""Run episodes on a robot and hand every tick of them over, whatever ends them."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum

import numpy as np
import torch
from numpy.typing import NDArray

from iher_robot.env.goal_env import EpisodeAborted, GoalRobotEnv, Info, Observation
from iher_robot.learning.episode import Episode
from iher_robot.learning.exploration import Explorer
from iher_robot.learning.goal_model import IMAGINED, REAL
from iher_robot.learning.policy import Policy
from iher_robot.signals import end_if_terminated
from iher_robot.storage.episode import RecordedTick, make_episode

Array = NDArray[np.floating]


class Stream(IntEnum):
    """Independent streams of episode seeds within a run."""

    COLLECTION = 0
    EVALUATION = 1
    FINAL_EVALUATION = 2


def episode_seed(run_seed: int, stream: Stream, index: int) -> int:
    """Seed of one episode, which depends on nothing that happened before it.

    So a resumed run draws the starts, goals and noise that it would have drawn.

    Args:
        run_seed: Seed of the run.
        stream: What the episode is for.
        index: Number of the episode within its stream, from 0.

    Returns:
        A seed below 2**32.
    """
    sequence = np.random.SeedSequence((run_seed, int(stream), index))
    return int(sequence.generate_state(1, np.uint32)[0])


class Recorder:
    """Counts the ticks of one episode, from before each begins.

    Attributes:
        ticks: Control ticks charged so far; the one in flight counts, since the robot may have
            moved in it.
        success: Whether the last step met the goal.
        aborted: Why the episode could not go on, empty if it could.
        policy_source: Source that the policy is told.
    """

    def __init__(self) -> None:
        self.ticks = 0
        self.success = False
        self.aborted = ""
        self.policy_source = REAL
        self._start: Observation | None = None
        self._ticks: list[RecordedTick] = []

    def start(self, observation: Observation) -> None:
        """Take the observation of a reset."""
        self._start = observation

    def step(self, env: GoalRobotEnv, action: Array) -> tuple[Observation, Info]:
        """Step the robot by one control tick and record it.

        Args:
            env: The environment.
            action: What the policy asks for, in [-1, 1]. ``(action_dim,)``

        Returns:
            The next observation, and what the environment reported of the tick.

        Raises:
            EpisodeAborted: The robot cannot go on; the tick is charged nevertheless.
            Terminated: The program was told to end, and goes on all the same.
        """
        end_if_terminated()
        self._charge(1)
        try:
            observation, _, _, _, info = env.step(action)
        except EpisodeAborted as error:
            self._charge(error.ticks - 1)
            raise
        self._charge(info["ticks"] - 1)  # ticks that passed unseen are charged as well
        assert env.state is not None, "a step that returns leaves a state"
        # One call: an interrupt finds the whole tick in the record, or nothing of it.
        self._record(
            RecordedTick(
                observation=observation["observation"],
                action=info["action_applied"],
                requested_action=action,
                valid=bool(info["tick_valid"]),
                seq=env.state.seq,
                elapsed=info["ticks"],
            )
        )
        self.success = bool(info["is_success"])
        return observation, info

    def episode(self) -> Episode | None:
        """The ticks recorded whole, as an episode; None before the first."""
        if self._start is None or not self._ticks:
            return None
        start = self._start
        return make_episode(start["observation"], start["desired_goal"], self._ticks)

    def _charge(self, ticks: int) -> None:
        self.ticks += ticks

    def _record(self, tick: RecordedTick) -> None:
        self._ticks.append(tick)


def choose_action(policy: Policy, observation: Observation, source: int) -> torch.Tensor:
    """Ask the policy for the action of one tick, without noise.

    Args:
        policy: A policy on the CPU.
        observation: What the environment returned.
        source: Index of the source that the policy is told.

    Returns:
        ``(1, action_dim)``
    """
    goal = _row(observation["desired_goal"])
    return policy.act(_row(observation["observation"]), goal, torch.tensor([source]))


def _row(values: Array) -> torch.Tensor:
    return torch.as_tensor(values, dtype=torch.float32).unsqueeze(0)


def run_episode(
    env: GoalRobotEnv,
    policy: Policy,
    recorder: Recorder,
    *,
    seed: int,
    ticks: int,
    explorer: Explorer | None = None,
) -> None:
    """Run one episode; the robot is left held and disarmed however it ends.

    Args:
        env: The environment. It arms the robot at reset.
        policy: A policy on the CPU: one action at a time is no work for a GPU.
        recorder: Takes every tick; the caller has it also when this raises.
        seed: Decides start, goal and noise.
        ticks: Most ticks to run.
        explorer: Disturbs the actions; None leaves them as they are.
    """
    generator = torch.Generator().manual_seed(seed)
    if explorer is not None:
        explorer.begin()
        if torch.rand((), generator=generator) < explorer.config.source_flip:
            recorder.policy_source = IMAGINED
    try:
        observation, _ = env.reset(seed=seed)
        recorder.start(observation)
        with _without_garbage_collection():
            while recorder.ticks < ticks:
                action = choose_action(policy, observation, recorder.policy_source)
                if explorer is not None:
                    action = explorer.act(_row(observation["observation"]), action, generator)
                observation, _ = recorder.step(env, action[0].numpy())
    except EpisodeAborted as error:
        recorder.success = False  # what was recorded until then is kept, and learned from
        recorder.aborted = str(error)
    finally:
        env.hold(after=sys.exception())


@contextmanager
def _without_garbage_collection() -> Iterator[None]:
    # One of all that torch and MuJoCo bring takes 0.2 s: five ticks, and as long as a host waits.
    before = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if before:
            gc.enable()
