"""What arrives at a gateway and waits: bounded, and nothing is lost without being counted."""

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

_BUFFER_BYTES = 1 << 20
_LONGEST_BYTES = 1 << 20


@dataclass(frozen=True)
class Note:
    """One message between the two.

    Attributes:
        kind: ``command``, ``request``, ``stop``, ``object``, ``refused`` on the way to the robot;
            ``state``, ``fault``, ``reply`` on the way out.
        number: Which request a reply answers; the lease of a state.
        name: Of the request or of the object; the boot of a state; the reason of a refusal.
        body: A message of the protocol.
    """

    kind: str
    number: int = 0
    name: str = ""
    body: bytes = b""


class Channel:
    """One end. Sending never waits: the control loop must not depend on the gateway's pace."""

    def __init__(self, end: socket.socket) -> None:
        """Take one end of `channel_ends`."""
        self._socket = end
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)

    def send(self, note: Note) -> bool:
        """Send.

        Returns:
            Whether it was sent: not if the other side is gone or too far behind.
        """
        packed = msgpack.packb((note.kind, note.number, note.name, note.body))
        try:
            self._socket.send(packed, socket.MSG_DONTWAIT)
        except OSError:
            return False
        return True

    def receive(self) -> Note | None:
        """Wait for the next; None once the other side is gone."""
        try:
            packed = self._socket.recv(_LONGEST_BYTES)
        except OSError:
            return None
        if not packed:
            return None
        kind, number, name, body = msgpack.unpackb(packed)
        return Note(kind, number, name, body)

    def close(self) -> None:
        """Close this end; who waits on it is told that the other side is gone."""
        with contextlib.suppress(OSError):  # the other side closed first
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


def channel_ends() -> tuple[socket.socket, socket.socket]:
    """Return two connected ends that keep messages apart."""
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)


log = logging.getLogger(__name__)

_CHANNEL = 1024


class Arrivals:
    """Messages of one kind, between Zenoh and whoever deals with them.

    Past a number of them the newest are refused. Zenoh itself would drop messages silently, or
    keep its network threads waiting, with the messages of everybody else behind them.
    """

    def __init__(
        self,
        declare: Callable[[Any], Any],
        most: int,
        most_bytes: int,
        refuse: Callable[[str], None],
    ) -> None:
        """Begin to hear.

        Args:
            declare: Declares a subscriber or queryable with the channel that it is given.
            most: How many may wait.
            most_bytes: How long each may be.
            refuse: Counts one that is refused, ``too_long`` or ``overrun``.
        """
        self._source = declare(zenoh.handlers.FifoChannel(_CHANNEL))
        self._waiting: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._most = most
        self._most_bytes = most_bytes
        self._refuse = refuse

    def collect(self) -> None:
        """Empty Zenoh's channel again and again, until the session is closed."""
        try:
            while True:
                message = self._source.recv()
                # All at once: each wait for the next lets the other threads go first.
                while message is not None:
                    self._sort(message)
                    message = self._source.try_recv()
        except zenoh.ZError:
            self._waiting.put(None)

    def deal(self, take: Callable[[Any], None]) -> None:
        """Hand over one after the other, until the session is closed.

        Args:
            take: Deals with a message.
        """
        while (message := self._waiting.get()) is not None:
            try:
                take(message)
            except Exception:  # one bad message must not silence a key for good
                log.exception("a message could not be dealt with")
                self._refuse("malformed")

    def _sort(self, message: Any) -> None:
        if message.payload is not None and len(message.payload) > self._most_bytes:
            self._refuse("too_long")
        elif self._waiting.qsize() >= self._most:
            self._refuse("overrun")
        else:
            self._waiting.put(message)
