"""Which of the commands that arrive reach the robot."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Mapping

import numpy as np

from drivers.clock import Clock
from drivers.errors import DriverError, InvalidCommand
from drivers.remote.messages import CommandMessage, unpack_command
from drivers.state_ages import StateAges
from drivers.wire import WireError
from iher_robot.host.lease import HostLease, SilenceTimer
from iher_robot.host.served_robot import ServedRobot

_TIMED_COMMANDS = 1500


class CommandHandler:
    """Takes commands as they arrive, trusts none of them, and counts what it refuses.

    In this order it refuses what is no command, what was sent to another start of the host,
    without the lease, twice or out of order, in answer to a state that is too old; the rest goes
    to the driver, whose safety filter judges and cuts it.
    """

    def __init__(
        self,
        boot: str,
        robot: ServedRobot,
        lease: HostLease,
        deadman: SilenceTimer,
        clock: Clock,
        age_ticks: float,
    ) -> None:
        """Begin with nothing published.

        Args:
            boot: Which start of the host this is.
            robot: Takes the commands.
            lease: Who may command.
            deadman: Told that the client is there.
            clock: The host's.
            age_ticks: Age of a state past which it cannot be answered any more.
        """
        self._boot = boot
        self._robot = robot
        self._lease = lease
        self._deadman = deadman
        self._clock = clock
        self._age_ticks = age_ticks
        self._published = StateAges(clock)
        self._answered_ms: deque[float] = deque(maxlen=_TIMED_COMMANDS)
        self._refused: Counter[str] = Counter()
        self._counting = threading.Lock()

    @property
    def refusals(self) -> Mapping[str, int]:
        """What host and driver refused, by reason; but for commands with its kind before it."""
        driver = {str(reason): n for reason, n in self._robot.driver.refusals.items()}
        with self._counting:
            return dict(self._refused + Counter(driver))

    def timing(self) -> dict[str, float]:
        """Return how long the last states waited for the commands that answer them, in `status`."""
        answered = np.percentile(self._answered_ms, [50, 99]) if self._answered_ms else (0.0, 0.0)
        return {
            "answer_p50_ms": float(answered[0]),
            "answer_p99_ms": float(answered[1]),
            "answers_timed": len(self._answered_ms),
        }

    def published(self, seq: int) -> None:
        """Note that a state was published now, so that commands may answer it."""
        self._published.add(seq, self._clock.now_ns())

    def forget(self) -> None:
        """Make every state so far unanswerable, as after a reset."""
        self._published.clear()

    def refuse(self, reason: str, count: int = 1) -> None:
        """Count what was refused, here or elsewhere; from any thread."""
        with self._counting:
            self._refused[reason] += count

    def take(self, body: bytes) -> None:
        """Take one command.

        Args:
            body: As it arrived.
        """
        try:
            message = unpack_command(body)
        except WireError as error:
            self.refuse(error.reason)
            return
        reason = self._why_not(message)
        if reason:
            self.refuse(reason)
            return
        self._lease.n = message.n
        self._lease.renew()
        self._deadman.restart()
        if message.kind == "hold":
            return
        age_ns = self._published.age_ns(message.answers)
        if age_ns is None:
            self.refuse("expired")
            return
        self._answered_ms.append(age_ns / 1e6)
        if age_ns > self._age_ticks * self._robot.spec.control_period_ns:
            self.refuse("expired")
            return
        try:
            command = message.command(self._robot.answers(message.answers))
            assert command is not None
            self._robot.driver.command(command)
        except InvalidCommand:
            self.refuse("invalid")
        except DriverError:
            self.refuse("failed")

    def _why_not(self, message: CommandMessage) -> str:
        if message.boot != self._boot:
            return "wrong_boot"
        if not self._lease.token or message.token != self._lease.token:
            return "wrong_token"
        return "repeated" if message.n <= self._lease.n else ""
