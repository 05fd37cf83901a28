"""Queues of the gateway: messages received over Zenoh, and the channel to the robot process."""

from __future__ import annotations

import contextlib
import logging
import queue
import socket
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgpack  # type: ignore[import-untyped]  # it ships neither types nor stubs
import zenoh

log = logging.getLogger(__name__)

_BUFFER_BYTES = 1 << 20
_MAX_BYTES = 1 << 20
_ZENOH_CHANNEL_SIZE = 1024


@dataclass(frozen=True)
class ChannelMessage:
    """A message between gateway and robot process.

    Attributes:
        kind: ``command``, ``request``, ``stop``, ``object`` or ``refused`` to the robot process;
            ``state``, ``fault`` or ``reply`` from it.
        number: Number of a request and of its reply; lease of a state; count of refusals.
        name: Name of the request or object; boot of a state; reason of refusals.
        body: A packed message of the protocol.
    """

    kind: str
    number: int = 0
    name: str = ""
    body: bytes = b""


class Channel:
    """One end of the channel. Sending never blocks, so that a slow gateway delays no tick."""

    def __init__(self, end: socket.socket) -> None:
        """Take one end of `channel_ends`."""
        self._socket = end
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)

    def send(self, message: ChannelMessage) -> bool:
        """Send a message, unless the other end is closed or its buffer is full.

        Returns:
            Whether it was sent.
        """
        packed = msgpack.packb((message.kind, message.number, message.name, message.body))
        try:
            self._socket.send(packed, socket.MSG_DONTWAIT)
        except OSError:
            return False
        return True

    def receive(self) -> ChannelMessage | None:
        """Wait for the next message; None once the other end is closed."""
        try:
            packed = self._socket.recv(_MAX_BYTES)
        except OSError:
            return None
        if not packed:
            return None
        kind, number, name, body = msgpack.unpackb(packed)
        return ChannelMessage(kind, number, name, body)

    def close(self) -> None:
        """Close this end; a `receive` in progress returns None."""
        with contextlib.suppress(OSError):  # the other end was closed first
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


def channel_ends() -> tuple[socket.socket, socket.socket]:
    """Return two connected sockets that keep message boundaries."""
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)


class ReceiveQueue:
    """A bounded queue of messages received over Zenoh; when full, new ones are refused and counted.

    Zenoh itself would drop messages silently, or block its network threads and with them the
    messages of all clients.
    """

    def __init__(
        self,
        declare: Callable[[Any], Any],
        max_waiting: int,
        max_bytes: int,
        refuse: Callable[[str], None],
    ) -> None:
        """Start to receive.

        Args:
            declare: Declares a subscriber or queryable, given the channel for its messages.
            max_waiting: Most messages that may wait.
            max_bytes: Greatest length of a message.
            refuse: Called with the reason of a refusal: ``too_long``, ``overrun`` or ``malformed``.
        """
        self._source = declare(zenoh.handlers.FifoChannel(_ZENOH_CHANNEL_SIZE))
        self._waiting: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._max_waiting = max_waiting
        self._max_bytes = max_bytes
        self._refuse = refuse

    def collect(self) -> None:
        """Move messages from Zenoh's channel to this queue until the session is closed."""
        try:
            while True:
                message = self._source.recv()
                # Drain it: each blocking call lets other threads run first.
                while message is not None:
                    self._sort(message)
                    message = self._source.try_recv()
        except zenoh.ZError:
            self._waiting.put(None)

    def handle(self, take: Callable[[Any], None]) -> None:
        """Handle one message after the other until the session is closed.

        Args:
            take: Handles a message.
        """
        while (message := self._waiting.get()) is not None:
            try:
                take(message)
            except Exception:  # one bad message must not end the handling of all others
                log.exception("a message could not be handled")
                self._refuse("malformed")

    def _sort(self, message: Any) -> None:
        if message.payload is not None and len(message.payload) > self._max_bytes:
            self._refuse("too_long")
        elif self._waiting.qsize() >= self._max_waiting:
            self._refuse("overrun")
        else:
            self._waiting.put(message)
