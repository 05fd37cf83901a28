"""The gateway of a host: its only process with a network connection."""

from __future__ import annotations

import logging
import threading
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any

import zenoh

from drivers.remote.keys import robot_key
from drivers.remote.messages import ObjectMessage, StopRequest, unpack_command
from drivers.remote.publishing import real_time_publisher
from drivers.wire import MAX_BYTES, Message, WireError, unpack
from iher_robot.host.network.channels import Channel, ChannelMessage, ReceiveQueue

log = logging.getLogger(__name__)

_MAX_WAITING = 1024
"""Messages of one kind that may wait: more than are handled before a command expires."""
_MAX_REQUESTS = 256
_MAX_COMMAND_BYTES = 8192
_MAX_OTHER_BYTES = MAX_BYTES // 8
_REPORT_AFTER = 64
_END_S = 1.0


class Gateway:
    """Forwards messages between Zenoh and the robot process.

    It refuses malformed messages, and commands without the lease or to another boot of the host,
    so that a flood of them costs the control loop no time. The loop checks everything again.
    """

    def __init__(self, session: zenoh.Session, robot: str, channel: Channel) -> None:
        """Declare the host's publishers, subscribers and queryables.

        Args:
            session: Zenoh session that listens.
            robot: Name of the robot.
            channel: To the robot process.
        """
        self._session = session
        self._robot = robot
        self._channel = channel
        self._expected: tuple[str, int] = ("", 0)
        self._unreported: Counter[str] = Counter()
        self._queries: dict[int, zenoh.Query] = {}
        self._request_count = 0
        self._lock = threading.Lock()
        self._threads: list[threading.Thread] = []
        self._states = real_time_publisher(session, self._key("state"))
        self._faults = real_time_publisher(session, self._key("fault"))
        self._alive = session.liveliness().declare_token(self._key("alive", "host"))
        subscribe = session.declare_subscriber
        self._receive("cmd", subscribe, self._command, _MAX_WAITING, _MAX_COMMAND_BYTES, "")
        self._receive("stop", subscribe, self._stop, _MAX_WAITING, _MAX_OTHER_BYTES, "request_")
        self._receive(
            "object/*", subscribe, self._object, _MAX_WAITING, _MAX_OTHER_BYTES, "object_"
        )
        queryable = session.declare_queryable
        self._receive(
            "rpc/*", queryable, self._request, _MAX_REQUESTS, _MAX_OTHER_BYTES, "request_"
        )

    def run(self) -> None:
        """Publish states and send replies of the robot process until it ends."""
        while (message := self._channel.receive()) is not None:
            if message.kind == "state":
                self._expected = (message.name, message.number)
                self._states.put(message.body)
            elif message.kind == "fault":
                self._faults.put(message.body)
            elif message.kind == "reply":
                self._reply(message.number, message.name, message.body)
        self._session.close()  # ends the threads that wait for it
        for thread in self._threads:
            thread.join(_END_S)

    def _command(self, sample: zenoh.Sample) -> None:
        body = sample.payload.to_bytes()
        try:
            message = unpack_command(body)
        except WireError as error:
            self._refuse(error.reason)
            return
        boot, token = self._expected
        if message.boot != boot:
            self._refuse("wrong_boot")
        elif not token or message.token != token:
            self._refuse("wrong_token")
        else:
            self._report_refusals()
            self._forward(ChannelMessage("command", body=body), "")

    def _stop(self, sample: zenoh.Sample) -> None:
        self._forward_valid(
            StopRequest, ChannelMessage("stop", body=sample.payload.to_bytes()), "request_"
        )

    def _object(self, sample: zenoh.Sample) -> None:
        name = str(sample.key_expr).rsplit("/", 1)[-1]
        message = ChannelMessage("object", name=name, body=sample.payload.to_bytes())
        self._forward_valid(ObjectMessage, message, "object_")

    def _request(self, query: zenoh.Query) -> None:
        self._report_refusals()
        name = str(query.key_expr).rsplit("/", 1)[-1]
        with self._lock:
            self._request_count += 1
            number = self._request_count
            self._queries[number] = query
            if len(self._queries) > _MAX_REQUESTS:
                del self._queries[next(iter(self._queries))]
        body = b"" if query.payload is None else query.payload.to_bytes()
        message = ChannelMessage("request", number, name, body)
        if not self._forward(message, "request_"):
            with self._lock:
                self._queries.pop(number, None)

    def _reply(self, number: int, name: str, body: bytes) -> None:
        with self._lock:
            query = self._queries.pop(number, None)
        if query is None:
            return
        try:
            with query:  # its end tells the client that no other reply follows
                query.reply(self._key("rpc", name), body, express=True)
        except zenoh.ZError as error:
            log.warning("the reply to %s could not be sent: %s", name, error)

    def _refuse(self, reason: str) -> None:
        with self._lock:
            self._unreported[reason] += 1
            full = self._unreported.total() >= _REPORT_AFTER
        if full:
            self._report_refusals()

    def _report_refusals(self) -> None:
        """Send the counts of refusals to the robot process."""
        with self._lock:
            refused, self._unreported = self._unreported, Counter()
        for reason, count in refused.items():
            if not self._channel.send(ChannelMessage("refused", count, reason)):
                with self._lock:
                    self._unreported[reason] += count

    def _forward_valid(self, model: type[Message], message: ChannelMessage, prefix: str) -> None:
        """Forward a message if it is valid."""
        try:
            unpack(model, message.body)
        except WireError as error:
            self._refuse(prefix + error.reason)
        else:
            self._forward(message, prefix)

    def _forward(self, message: ChannelMessage, prefix: str) -> bool:
        sent = self._channel.send(message)
        if not sent:
            self._refuse(f"{prefix}overrun")
        return sent

    def _receive(
        self,
        name: str,
        declare: Callable[..., Any],
        take: Callable[[Any], None],
        max_waiting: int,
        max_bytes: int,
        prefix: str,
    ) -> None:
        """Receive and handle the messages of a key, in separate threads.

        Args:
            name: The key, below the robot's.
            declare: Declares a subscriber or queryable.
            take: Handles a message.
            max_waiting: Most messages that may wait.
            max_bytes: Greatest length of a message.
            prefix: Of the reasons under which refusals are counted.
        """
        received = ReceiveQueue(
            partial(declare, self._key(name)),
            max_waiting,
            max_bytes,
            lambda reason: self._refuse(prefix + reason),
        )
        self._start(f"{name} receive", received.collect)
        self._start(name, received.handle, take)

    def _start(self, name: str, target: Callable[..., None], *arguments: object) -> None:
        thread = threading.Thread(target=target, args=arguments, daemon=True, name=name)
        thread.start()
        self._threads.append(thread)

    def _key(self, *parts: str) -> str:
        return robot_key(self._robot, *parts)
