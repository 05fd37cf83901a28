"""Client session with a robot's host: requests, commands, and the stream of states."""

from __future__ import annotations

import atexit
import logging
import re
import threading
import time
from collections.abc import Callable
from typing import Any

import zenoh

from drivers import errors
from drivers.closing import Closing
from drivers.errors import DriverError, LinkLost
from drivers.remote.keys import robot_key
from drivers.remote.link import LinkOptions, open_session
from drivers.remote.messages import FAULT_NAME, Reply, StopRequest
from drivers.remote.publishing import real_time_publisher
from drivers.wire import Message, WireError, pack, unpack

log = logging.getLogger(__name__)

_LONGEST_REASON = 4000
_RETRY_PERIOD_S = 0.1
"""Pause between two attempts to stop a robot that did not acknowledge."""

_ERRORS: dict[str, type[DriverError]] = {
    name: kind
    for name, kind in vars(errors).items()
    if isinstance(kind, type) and issubclass(kind, DriverError)
}


class RobotClient(Closing):
    """Session with the host of one robot. Thread-safe.

    Args:
        options: Address of the robot, and credentials.

    Raises:
        LinkLost: No host answers.
    """

    def __init__(self, options: LinkOptions) -> None:
        self.options = options
        self._session = open_session(options)
        self._commands = real_time_publisher(self._session, self._key("cmd"))
        self._stops = real_time_publisher(self._session, self._key("stop"))
        # A thread that waits for Zenoh while the interpreter shuts down crashes the process.
        atexit.register(self.close)
        self._states: zenoh.Subscriber[Any] | None = None
        self._listener: threading.Thread | None = None
        self._alive: zenoh.LivelinessToken | None = None

    def listen(self, on_state: Callable[[bytes, int], None]) -> None:
        """Receive states in a separate thread. Of several that wait only the newest is kept.

        Args:
            on_state: Called with a packed state and its time of receipt on this machine's clock.
        """
        self._states = self._session.declare_subscriber(
            self._key("state"), zenoh.handlers.RingChannel(1)
        )
        self._listener = threading.Thread(
            target=self._listen, args=(self._states, on_state), daemon=True, name="robot states"
        )
        self._listener.start()

    def announce(self, session: str) -> None:
        """Declare a liveliness token. It is no deadman: a frozen client keeps it."""
        self._alive = self._session.liveliness().declare_token(self._key("alive", session))

    def send(self, command: bytes) -> None:
        """Publish a command; it is dropped when the link is congested."""
        try:
            self._commands.put(command)
        except zenoh.ZError as error:
            raise LinkLost(f"a command cannot be sent to {self._robot}: {error}") from error

    def request(self, name: str, message: Message, timeout_s: float | None = None) -> Reply:
        """Send a request to the host, and wait for the reply.

        Args:
            name: Name of the request, one of `drivers.remote.keys.REQUESTS`.
            message: The request.
            timeout_s: Longest time to wait; that of the options by default.

        Raises:
            LinkLost: No reply in time, or one of another protocol.
            DriverError: The error that the host reports, of the type that it names.
        """
        limit_s = self.options.timeout_s if timeout_s is None else timeout_s
        key, begun = self._key("rpc", name), time.monotonic()
        try:
            replies = self._session.get(
                key,
                payload=pack(message),
                timeout=limit_s,
                priority=zenoh.Priority.REAL_TIME,
                congestion_control=zenoh.CongestionControl.BLOCK,
                express=True,
            )
            answer = next((reply.ok for reply in replies if reply.ok is not None), None)
        except zenoh.ZError as error:
            raise LinkLost(f"request {name} to {self._robot} failed: {error}") from error
        if answer is None:
            waited_s = time.monotonic() - begun
            if waited_s < limit_s:
                raise LinkLost(
                    f"{self._robot} does not answer {name}: its host is gone, or does not allow it "
                    "to these credentials"
                )
            raise LinkLost(
                f"{self._robot} does not answer {name} within {limit_s:g} s; check that its host "
                "runs, and measure the link with: iher-robot doctor"
            )
        try:
            reply = unpack(Reply, answer.payload.to_bytes())
        except WireError as error:
            raise LinkLost(f"{self._robot} answers {name} in another protocol: {error}") from error
        if not reply.ok:
            raise _ERRORS.get(reply.error, DriverError)(reply.message)
        return reply

    def stop(self, fault: str, reason: str, patience_s: float) -> Reply:
        """Stop and latch, as message and as request, repeatedly until the host acknowledges.

        Args:
            fault: Name of the fault.
            reason: What happened, for people.
            patience_s: How long to try.

        Returns:
            The acknowledgement.

        Raises:
            LinkLost: The host did not acknowledge. The robot may be moving.
        """
        if not re.fullmatch(FAULT_NAME, fault):  # the robot must stop, even under a bad name
            fault, reason = "emergency_stop", f"{fault!r}: {reason}"
        message = StopRequest(fault=fault, reason=reason[:_LONGEST_REASON])
        deadline = time.monotonic() + patience_s
        while True:
            try:
                self._stops.put(pack(message))
                return self.request("stop", message, min(self.options.timeout_s, patience_s))
            except (LinkLost, zenoh.ZError) as error:
                if time.monotonic() >= deadline:
                    raise LinkLost(
                        f"NOT CONFIRMED: {self._robot} did not acknowledge the stop within "
                        f"{patience_s:g} s; use the robot's own emergency stop"
                    ) from error
                time.sleep(_RETRY_PERIOD_S)

    def close(self) -> None:
        """End the session. Idempotent."""
        atexit.unregister(self.close)
        self._session.close()
        if self._listener is not None and self._listener is not threading.current_thread():
            self._listener.join(timeout=1.0)

    @property
    def _robot(self) -> str:
        return f"robot {self.options.robot!r} at {', '.join(self.options.connect)}"

    def _key(self, *parts: str) -> str:
        return robot_key(self.options.robot, *parts)

    def _listen(
        self, states: zenoh.Subscriber[Any], on_state: Callable[[bytes, int], None]
    ) -> None:
        try:
            for sample in states:
                on_state(sample.payload.to_bytes(), time.monotonic_ns())
        except zenoh.ZError:
            return  # the session was closed
