"""Ticks of a robot that are written down: before each begins, and what became of it after."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack

from iher_robot.env.goal_env import GoalRobotEnv, Observation
from iher_robot.errors import describe
from iher_robot.rollout.episode import Recorder
from iher_robot.rollout.timing import TickJitter
from iher_robot.storage.episode import DONE, EpisodeHeader, RecordedTick
from iher_robot.storage.episode_store import EpisodeStore
from iher_robot.storage.ledger import Entry, Ledger

RESET_AHEAD_S = 120.0
"""Robot time that is written down before a reset: nobody knows how long it will take."""


class DurableRecorder(Recorder):
    """Writes every tick down: that it begins before it does, and what became of it after.

    A ``with`` block around the episode seals it and settles its account, whatever ends it.

    Args:
        env: The robot.
        store: Keeps the ticks.
        reserve: Reserves them.
        ledger: Accounts of the run.
        header: Makes the header from the source that the policy is told and the reservation.
        jitter: Told of each state; None where nobody asks.
    """

    def __init__(
        self,
        env: GoalRobotEnv,
        store: EpisodeStore,
        reserve: Callable[[], AbstractContextManager[Entry]],
        ledger: Ledger,
        header: Callable[[int, int], EpisodeHeader],
        jitter: TickJitter | None = None,
    ) -> None:
        super().__init__()
        self._driver = env.driver
        self._period_ns = env.robot_spec.control_period_ns
        self._store = store
        self._reserve = reserve
        self._ledger = ledger
        self._header = header
        self._jitter = jitter
        self._stack = ExitStack()

    def __enter__(self) -> DurableRecorder:
        self._entry = self._stack.enter_context(self._reserve())
        ahead = math.ceil(RESET_AHEAD_S * 1e9 / self._period_ns)
        self._reset: Entry | None = self._stack.enter_context(self._ledger.reserve("reset", ahead))
        self._reset_begun_ns = self._driver.now_ns
        return self

    def __exit__(self, *_: object) -> None:
        error = sys.exception()
        ended = self.aborted or (DONE if error is None else describe(error))
        with self._stack:
            try:
                self._settle_reset()
            finally:
                self._store.seal(ended)
                self._entry.settle(self.ticks)  # last: a failure before it leaves what had begun

    def start(self, observation: Observation) -> None:
        """Take the observation of a reset."""
        super().start(observation)
        if self._jitter is not None:
            self._jitter.begin()
        self._settle_reset()
        header = self._header(self.policy_source, self._entry.number)
        self._store.begin(header, observation["observation"], observation["desired_goal"])

    def _charge(self, ticks: int) -> None:
        if ticks:
            self._entry.begin(self.ticks + ticks)
        super()._charge(ticks)

    def _record(self, tick: RecordedTick) -> None:
        if self._jitter is not None:
            self._jitter.tick(tick.elapsed)
        super()._record(tick)
        self._store.record(tick)

    def _settle_reset(self) -> None:
        entry, self._reset = self._reset, None  # not a second time, if the first is interrupted
        if entry is not None:
            elapsed_ns = self._driver.now_ns - self._reset_begun_ns
            entry.settle(-(-elapsed_ns // self._period_ns))
