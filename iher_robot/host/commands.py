"""Checks commands from the network and passes the valid ones to the robot's driver."""

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

_TIMED_ANSWERS = 1500


class CommandHandler:
    """Takes commands as they arrive and counts those that it refuses, by reason.

    It refuses, in this order: malformed commands, commands to another boot of the host, without
    the lease, repeated or out of order, and in answer to a state that is too old. The driver's
    safety filter checks and limits the others.
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
        """Start without a published state.

        Args:
            boot: Identifies this start of the host.
            robot: Gets the commands.
            lease: The lease of the client that may command.
            deadman: Restarted by each command of that client.
            clock: The host's.
            age_ticks: Greatest age of a state that a command may answer, in control ticks.
        """
        self._boot = boot
        self._robot = robot
        self._lease = lease
        self._deadman = deadman
        self._clock = clock
        self._age_ticks = age_ticks
        self._published = StateAges(clock)
        self._answer_times_ms: deque[float] = deque(maxlen=_TIMED_ANSWERS)
        self._refused: Counter[str] = Counter()
        self._count_lock = threading.Lock()

    @property
    def refusals(self) -> Mapping[str, int]:
        """Messages refused by the host and the driver, by reason.

        The reasons of other messages than commands have the kind of message as a prefix.
        """
        driver = {str(reason): n for reason, n in self._robot.driver.refusals.items()}
        with self._count_lock:
            return dict(self._refused + Counter(driver))

    def timing(self) -> dict[str, float]:
        """Return how long after their publication the last states were answered, for `status`."""
        answered = (
            np.percentile(self._answer_times_ms, [50, 99]) if self._answer_times_ms else (0.0, 0.0)
        )
        return {
            "answer_p50_ms": float(answered[0]),
            "answer_p99_ms": float(answered[1]),
            "answers_timed": len(self._answer_times_ms),
        }

    def published(self, seq: int) -> None:
        """Record that a state was published now; from now on commands may answer it."""
        self._published.add(seq, self._clock.now_ns())

    def forget(self) -> None:
        """Expire all states published so far, as after a reset."""
        self._published.clear()

    def refuse(self, reason: str, count: int = 1) -> None:
        """Count messages that were refused, here or by the gateway. Thread-safe."""
        with self._count_lock:
            self._refused[reason] += count

    def take(self, body: bytes) -> None:
        """Check a command, and pass it to the driver if it is valid.

        Args:
            body: The packed message.
        """
        try:
            message = unpack_command(body)
        except WireError as error:
            self.refuse(error.reason)
            return
        reason = self._check_sender(message)
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
        self._answer_times_ms.append(age_ns / 1e6)
        if age_ns > self._age_ticks * self._robot.spec.control_period_ns:
            self.refuse("expired")
            return
        try:
            command = message.command(self._robot.driver_seq(message.answers))
            assert command is not None, "only a hold has none"
            self._robot.driver.command(command)
        except InvalidCommand:
            self.refuse("invalid")
        except DriverError:
            self.refuse("failed")

    def _check_sender(self, message: CommandMessage) -> str:
        if message.boot != self._boot:
            return "wrong_boot"
        if not self._lease.token or message.token != self._lease.token:
            return "wrong_token"
        return "repeated" if message.n <= self._lease.n else ""
