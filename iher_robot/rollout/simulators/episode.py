"""An episode in a simulator of another process, and how it comes here."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from iher_robot.env.goal_env import GoalRobotEnv, Observation
from iher_robot.learning.episode import Episode
from iher_robot.rollout.episode import Recorder
from iher_robot.rollout.simulators.messages import Message, pack_episodes, unpack_episodes
from iher_robot.storage.episode import RecordedTick


@dataclass(frozen=True)
class Order:
    """What a simulator is to run.

    Attributes:
        seed: Decides start, goal and noise.
        ticks: Most ticks to run.
        explores: Whether the policy's actions are disturbed.
    """

    seed: int
    ticks: int
    explores: bool


@dataclass(frozen=True, eq=False)
class SimulatedEpisode:
    """What became of an order.

    Attributes:
        ticks: Control ticks charged.
        reset_ticks: Control ticks that the reset took.
        success: Whether the last step met the goal.
        aborted: Why the episode could not go on, empty if it could.
        policy_source: Source that the policy was told.
        ended: How it ended, in words.
        failure: A sentence for the user where an error ended it, else empty.
        steps: For each tick, the simulator's counter at its end, from the end of the reset on.
            ``(length,)``
        elapsed: Ticks charged for each. ``(length,)``
        data: What was recorded; None before the first whole tick.
    """

    ticks: int
    reset_ticks: int
    success: bool
    aborted: str
    policy_source: int
    ended: str
    failure: str
    steps: NDArray[np.int64]
    elapsed: NDArray[np.int64]
    data: Episode | None

    def episode(self) -> Episode | None:
        """The ticks recorded whole, as an episode; None before the first."""
        return self.data

    @staticmethod
    def from_message(message: Message) -> SimulatedEpisode:
        """Read what ``SentRecorder.message`` returned."""
        told = dict(message)
        episodes = unpack_episodes(told.pop("episodes"))
        steps, elapsed = told.pop("steps").numpy(), told.pop("elapsed").numpy()
        del told["kind"]
        return SimulatedEpisode(
            **told, steps=steps, elapsed=elapsed, data=episodes[0] if episodes else None
        )


class SentRecorder(Recorder):
    """Counts the ticks of an episode that is told to another process when it is over.

    Args:
        env: The simulator, which is open.
    """

    def __init__(self, env: GoalRobotEnv) -> None:
        super().__init__()
        self._env = env
        self._begun_ns = env.driver.now_ns
        self._reset_ticks: int | None = None
        self._first = 0
        self._seqs: list[int] = []
        self._elapsed: list[int] = []

    def start(self, observation: Observation) -> None:
        """Take the observation of a reset."""
        super().start(observation)
        assert self._env.state is not None, "a reset that returns leaves a state"
        self._first = self._env.state.seq
        self._reset_ticks = self._ticks_since_begun()

    def message(self, ended: str, failure: str) -> Message:
        """All of it, for ``SimulatedEpisode.from_message``.

        Args:
            ended: How the episode ended, in words.
            failure: A sentence for the user where an error ended it, else empty.
        """
        episode, reset_ticks = self.episode(), self._reset_ticks
        return {
            "kind": "episode",
            "ticks": self.ticks,
            "reset_ticks": self._ticks_since_begun() if reset_ticks is None else reset_ticks,
            "success": self.success,
            "aborted": self.aborted,
            "policy_source": self.policy_source,
            "ended": ended,
            "failure": failure,
            "steps": torch.tensor(self._seqs, dtype=torch.int64) - self._first,
            "elapsed": torch.tensor(self._elapsed, dtype=torch.int64),
            "episodes": pack_episodes([] if episode is None else [episode]),
        }

    def _record(self, tick: RecordedTick) -> None:
        super()._record(tick)
        self._seqs.append(tick.seq)
        self._elapsed.append(tick.elapsed)

    def _ticks_since_begun(self) -> int:
        driver = self._env.driver
        return -(-(driver.now_ns - self._begun_ns) // driver.spec.control_period_ns)
