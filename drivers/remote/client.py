"""A session with a robot's host: requests, commands, and the newest state."""

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
_AGAIN_S = 0.1
"""Pause between two attempts to stop a robot that did not acknowledge."""

_ERRORS: dict[str, type[DriverError]] = {
    name: kind
    for name, kind in vars(errors).items()
    if isinstance(kind, type) and issubclass(kind, DriverError)
}


class RobotClient(Closing):
    """One session with the host of one robot. Every method may be called from any thread.

    Args:
        options: Where the robot is, and who asks.

    Raises:
        LinkLost: Nobody answers there.
    """

    def __init__(self, options: LinkOptions) -> None:
        self.options = options
        self._session = open_session(options)
        self._commands = real_time_publisher(self._session, self._key("cmd"))
        self._stops = real_time_publisher(self._session, self._key("stop"))
        # A thread that waits for Zenoh while the interpreter ends would take the process with it.
        atexit.register(self.close)
        self._states: zenoh.Subscriber[Any] | None = None
        self._listener: threading.Thread | None = None
        self._alive: zenoh.LivelinessToken | None = None

    def listen(self, on_state: Callable[[bytes, int], None]) -> None:
        """Hand over every state, from a thread of its own; of several that wait only the newest.

        Args:
            on_state: Takes a message and when it was received, on this machine's clock.
        """
        self._states = self._session.declare_subscriber(
            self._key("state"), zenoh.handlers.RingChannel(1)
        )
        self._listener = threading.Thread(
            target=self._listen, args=(self._states, on_state), daemon=True, name="robot states"
        )
        self._listener.start()

    def announce(self, session: str) -> None:
        """Show others that this client lives. It is no deadman: a frozen one lives on."""
        self._alive = self._session.liveliness().declare_token(self._key("alive", session))

    def send(self, command: bytes) -> None:
        """Publish a command; it is dropped where the link is congested."""
        try:
            self._commands.put(command)
        except zenoh.ZError as error:
            raise LinkLost(f"a command cannot be sent to {self._robot}: {error}") from error

    def request(self, name: str, message: Message, timeout_s: float | None = None) -> Reply:
        """Ask the host.

        Args:
            name: What for, as in `drivers.remote.keys.REQUESTS`.
            message: The content.
            timeout_s: Longest time to wait; that of the options where None.

        Returns:
            The answer.

        Raises:
            LinkLost: No answer in time, or none of this protocol.
            DriverError: What the host says went wrong, of the type that it names.
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
            raise LinkLost(f"{self._robot} cannot be asked for {name}: {error}") from error
        if answer is None:
            waited_s = time.monotonic() - begun
            if waited_s < limit_s:
                raise LinkLost(
                    f"{self._robot} does not answer {name}: its host is gone, or does not allow it "
                    "to these credentials"
                )
            raise LinkLost(
                f"{self._robot} does not answer {name} within {limit_s:g} s; see that its host "
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
        """Stop and latch, on both paths, again and again until the host acknowledges.

        Args:
            fault: Name under which it latches.
            reason: What happened, in words.
            patience_s: How long to try.

        Returns:
            The acknowledgement.

        Raises:
            LinkLost: None came. The robot may be moving.
        """
        if not re.fullmatch(FAULT_NAME, fault):  # whatever its name, the robot must stop
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
                time.sleep(_AGAIN_S)

    def close(self) -> None:
        """End the session; twice does nothing."""
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
