"""Episode of a simulator process: what is ordered, recorded and sent back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.learning.episode import Episode
from iher_robot.rollout.observer import EpisodeStart
from iher_robot.rollout.recorder import Recorder
from iher_robot.rollout.simulators.messages import Message, pack_episodes, unpack_episodes
from iher_robot.storage.episode import RecordedTick
from iher_robot.storage.robot_time import RobotTime


@dataclass(frozen=True)
class Order:
    """Order to a simulator process: run one episode.

    Attributes:
        seed: Decides start, goal and noise.
        ticks: Most ticks to run.
        explores: Whether the explorer disturbs the actions.
    """

    seed: int
    ticks: int
    explores: bool


@dataclass(frozen=True, eq=False)
class SimulatedEpisode:
    """Outcome and data of an ordered episode.

    Attributes:
        ticks: Control ticks charged.
        reset_ticks: Control ticks that the reset took.
        success: Whether the last step met the goal.
        aborted: Why the episode could not go on, empty if it could.
        policy_source: Index of the replay source that the policy was conditioned on.
        ended: ``"done"``, or why it ended early.
        failure: A sentence for the user where an error ended it, else empty.
        steps: For each tick, the simulator's counter at its end, from the end of the reset on.
            ``(length,)``
        elapsed: Ticks charged for each. ``(length,)``
        data: The record; None before the first whole tick.
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
        values = dict(message)
        episodes = unpack_episodes(values.pop("episodes"))
        steps, elapsed = values.pop("steps").numpy(), values.pop("elapsed").numpy()
        del values["kind"]
        return SimulatedEpisode(
            **values, steps=steps, elapsed=elapsed, data=episodes[0] if episodes else None
        )


class SentRecorder(Recorder):
    """Records an episode that is sent to the training process when it has ended.

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

    def start(self, start: EpisodeStart) -> None:
        """Note the reset's duration."""
        super().start(start)
        assert self._env.state is not None, "a reset that returns leaves a state"
        self._first = self._env.state.seq
        self._reset_ticks = self._ticks_since_begun()

    def message(self, ended: str, failure: str) -> Message:
        """The message for ``SimulatedEpisode.from_message``.

        Args:
            ended: ``"done"``, or why the episode ended early.
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
        elapsed_ns = driver.now_ns - self._begun_ns
        return RobotTime.from_ns(elapsed_ns, driver.spec.control_period_s).ticks
