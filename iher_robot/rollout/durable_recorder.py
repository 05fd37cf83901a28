"""Durable record of an episode: each tick is charged before it begins, and stored after it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack

from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.errors import describe
from iher_robot.rollout.observer import EpisodeStart
from iher_robot.rollout.recorder import Recorder
from iher_robot.rollout.timing import TickJitter
from iher_robot.storage.episode import DONE, EpisodeHeader, RecordedTick
from iher_robot.storage.episode_store import EpisodeStore
from iher_robot.storage.ledger import Entry, Ledger
from iher_robot.storage.robot_time import RobotTime

RESET_AHEAD_S = 120.0
"""Robot time that is reserved before a reset, whose duration is not known ahead."""


class DurableRecorder(Recorder):
    """Charges every tick to the ledger before it begins, and stores it before the next one.

    A ``with`` block around the episode seals it and settles its account, whatever ends it.

    Args:
        env: The robot.
        store: Keeps the ticks.
        reserve: Reserves them.
        ledger: Accounts of the run.
        header: Makes the header from the policy source and the reservation.
        jitter: Measures the time between states; None for no measurement.
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
        self._period_s = env.robot_spec.control_period_s
        self._store = store
        self._reserve = reserve
        self._ledger = ledger
        self._header = header
        self._jitter = jitter
        self._stack = ExitStack()

    def __enter__(self) -> DurableRecorder:
        self._entry = self._stack.enter_context(self._reserve())
        ahead = RobotTime.from_seconds(RESET_AHEAD_S, self._period_s).ticks
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

    def start(self, start: EpisodeStart) -> None:
        """Settle the reset, and begin the episode in the store."""
        super().start(start)
        if self._jitter is not None:
            self._jitter.begin()
        self._settle_reset()
        header = self._header(self.policy_source, self._entry.number)
        observation = start.observation
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
            entry.settle(RobotTime.from_ns(elapsed_ns, self._period_s).ticks)
