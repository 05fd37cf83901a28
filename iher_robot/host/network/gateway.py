"""The gateway of a host: the only process of it that the network reaches."""

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
from iher_robot.host.network.channels import Arrivals, Channel, Note

log = logging.getLogger(__name__)

_WAITING = 1024
"""Messages of one kind that may wait: more than are dealt with before a command expires."""
_REQUESTS = 256
_COMMAND_BYTES = 8192
_OTHER_BYTES = MAX_BYTES // 8
_TELL_AFTER = 64
_END_S = 1.0


class Gateway:
    """Carries messages between Zenoh and the robot process.

    It sorts out what is no message, and commands that cannot be meant for this robot now, so that
    a flood of them costs the control loop nothing; the loop checks everything again.
    """

    def __init__(self, session: zenoh.Session, robot: str, channel: Channel) -> None:
        """Declare what the host publishes, hears and answers.

        Args:
            session: Listening.
            robot: Name of the robot.
            channel: To the robot process.
        """
        self._session = session
        self._robot = robot
        self._channel = channel
        self._expected: tuple[str, int] = ("", 0)
        self._refused: Counter[str] = Counter()
        self._queries: dict[int, zenoh.Query] = {}
        self._asked = 0
        self._lock = threading.Lock()
        self._threads: list[threading.Thread] = []
        self._states = real_time_publisher(session, self._key("state"))
        self._faults = real_time_publisher(session, self._key("fault"))
        self._alive = session.liveliness().declare_token(self._key("alive", "host"))
        hear = session.declare_subscriber
        self._wait_for("cmd", hear, self._command, _WAITING, _COMMAND_BYTES, "")
        self._wait_for("stop", hear, self._stop, _WAITING, _OTHER_BYTES, "request_")
        self._wait_for("object/*", hear, self._object, _WAITING, _OTHER_BYTES, "object_")
        answer = session.declare_queryable
        self._wait_for("rpc/*", answer, self._request, _REQUESTS, _OTHER_BYTES, "request_")

    def run(self) -> None:
        """Carry what the robot process says, until it ends."""
        while (note := self._channel.receive()) is not None:
            if note.kind == "state":
                self._expected = (note.name, note.number)
                self._states.put(note.body)
            elif note.kind == "fault":
                self._faults.put(note.body)
            elif note.kind == "reply":
                self._reply(note.number, note.name, note.body)
        self._session.close()  # which ends what waits for it
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
            self._tell()
            self._pass_on(Note("command", body=body), "")

    def _stop(self, sample: zenoh.Sample) -> None:
        self._checked(StopRequest, Note("stop", body=sample.payload.to_bytes()), "request_")

    def _object(self, sample: zenoh.Sample) -> None:
        name = str(sample.key_expr).rsplit("/", 1)[-1]
        note = Note("object", name=name, body=sample.payload.to_bytes())
        self._checked(ObjectMessage, note, "object_")

    def _request(self, query: zenoh.Query) -> None:
        self._tell()
        name = str(query.key_expr).rsplit("/", 1)[-1]
        with self._lock:
            self._asked += 1
            number = self._asked
            self._queries[number] = query
            if len(self._queries) > _REQUESTS:
                del self._queries[next(iter(self._queries))]
        body = b"" if query.payload is None else query.payload.to_bytes()
        note = Note("request", number, name, body)
        if not self._pass_on(note, "request_"):
            with self._lock:
                self._queries.pop(number, None)

    def _reply(self, number: int, name: str, body: bytes) -> None:
        with self._lock:
            query = self._queries.pop(number, None)
        if query is None:
            return
        try:
            with query:  # leaving it tells the client that there is no other answer
                query.reply(self._key("rpc", name), body, express=True)
        except zenoh.ZError as error:
            log.warning("the answer to %s could not be sent: %s", name, error)

    def _refuse(self, reason: str) -> None:
        with self._lock:
            self._refused[reason] += 1
            full = self._refused.total() >= _TELL_AFTER
        if full:
            self._tell()

    def _tell(self) -> None:
        """Report what was refused here, many at once."""
        with self._lock:
            refused, self._refused = self._refused, Counter()
        for reason, count in refused.items():
            if not self._channel.send(Note("refused", count, reason)):
                with self._lock:
                    self._refused[reason] += count

    def _checked(self, model: type[Message], note: Note, kind: str) -> None:
        """Pass on what is a message of this kind."""
        try:
            unpack(model, note.body)
        except WireError as error:
            self._refuse(kind + error.reason)
        else:
            self._pass_on(note, kind)

    def _pass_on(self, note: Note, kind: str) -> bool:
        sent = self._channel.send(note)
        if not sent:
            self._refuse(f"{kind}overrun")
        return sent

    def _wait_for(
        self,
        name: str,
        declare: Callable[..., Any],
        take: Callable[[Any], None],
        most: int,
        most_bytes: int,
        kind: str,
    ) -> None:
        """Deal with the messages of a key, in threads of their own."""
        arrivals = Arrivals(
            partial(declare, self._key(name)),
            most,
            most_bytes,
            lambda reason: self._refuse(kind + reason),
        )
        self._start(f"{name} arrive", arrivals.collect)
        self._start(name, arrivals.deal, take)

    def _start(self, name: str, target: Callable[..., None], *arguments: object) -> None:
        thread = threading.Thread(target=target, args=arguments, daemon=True, name=name)
        thread.start()
        self._threads.append(thread)

    def _key(self, *parts: str) -> str:
        return robot_key(self._robot, *parts)
