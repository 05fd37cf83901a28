"""What arrives at a gateway and waits: bounded, and nothing is lost without being counted."""

from __future__ import annotations

import logging
import queue
from collections.abc import Callable
from typing import Any

import zenoh

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
