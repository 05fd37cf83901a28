"""What robot process and gateway tell each other: MessagePack over a local socket."""

from __future__ import annotations

import contextlib
import socket
from dataclasses import dataclass

import msgpack  # type: ignore[import-untyped]  # it ships neither types nor stubs

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
