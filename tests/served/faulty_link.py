"""A link that randomly loses, delays, reorders, repeats and damages messages, from a seed."""

from __future__ import annotations

import heapq
import itertools
import threading
import time
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import zenoh

from drivers.closing import Closing
from drivers.remote.keys import robot_key
from drivers.remote.link import POINT_TO_POINT, link_options, make_config, open_session
from drivers.remote.publishing import real_time_publisher
from tests.served.served_robot import free_port

ROBOT = "fetch"
TO_HOST, TO_CLIENT = "to host", "to client"
_OVERTAKEN_S = 0.1
"""A message that waits to be overtaken is delivered after this time without another one."""
_REPLY_S = 120.0

Deliver = Callable[[bytes], None]


@dataclass(frozen=True)
class Faults:
    """Faults of the messages in both directions.

    Attributes:
        drop: Probability that it is lost.
        delay_ms: Bounds of its uniformly distributed delay.
        swap: Probability that the next one of its kind overtakes it.
        duplicate: Probability that it arrives a second time, with another delay.
        truncate: Probability that its end is missing.
    """

    drop: float = 0.0
    delay_ms: tuple[float, float] = (0.0, 0.0)
    swap: float = 0.0
    duplicate: float = 0.0
    truncate: float = 0.0


NO_FAULTS = Faults()


class FaultyLink(Closing):
    """Relay between a host and the clients that connect to it, with a session for each side.

    The faults of the n-th message of a stream (a key and a direction) depend on the seed only.

    Attributes:
        endpoint: Where clients connect.
        faults: The current faults; may be changed at any time.
        partitioned: Whether no message passes, including those in transit.
        passed: Messages delivered, by direction and key.
        suffered: Faults, by kind.
    """

    def __init__(self, host: str, faults: Faults = NO_FAULTS, seed: int = 0) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.faults = faults
        self.partitioned = False
        self.passed: Counter[tuple[str, str]] = Counter()
        self.suffered: Counter[str] = Counter()
        self._seed = seed
        self._rngs: dict[tuple[str, str], np.random.Generator] = {}
        self._overtaken: dict[tuple[str, str], _Once] = {}
        self._lock = threading.Lock()
        self._timetable = _Timetable()
        self._queries: list[zenoh.Query] = []  # a query that is released counts as answered
        self._to_host = open_session(link_options({"connect": [host]}))
        listening = {"listen/endpoints": [self.endpoint], "listen/exit_on_failure": True}
        self._to_clients = zenoh.open(make_config({**POINT_TO_POINT, **listening}))
        self._relay(self._to_host, self._to_clients, "state", TO_CLIENT)
        self._relay(self._to_clients, self._to_host, "cmd", TO_HOST)
        self._relay(self._to_clients, self._to_host, "stop", TO_HOST)
        queryable = self._to_clients.declare_queryable(robot_key(ROBOT, "rpc", "*"))
        self._start(queryable, self._ask)

    def close(self) -> None:
        self._timetable.close()
        self._to_clients.close()
        self._to_host.close()

    def _relay(
        self, source: zenoh.Session, target: zenoh.Session, name: str, direction: str
    ) -> None:
        publisher = real_time_publisher(target, robot_key(ROBOT, name))
        self._start(
            source.declare_subscriber(robot_key(ROBOT, name)),
            lambda sample: self._send((direction, name), sample.payload.to_bytes(), publisher.put),
        )

    def _ask(self, query: zenoh.Query) -> None:
        key = str(query.key_expr)
        name = key.split("/", 3)[-1]
        self._queries.append(query)

        def give(body: bytes) -> None:
            with query:  # its end tells Zenoh that no other reply follows
                query.reply(key, body)

        def answer(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                self._send((TO_CLIENT, name), reply.ok.payload.to_bytes(), give)

        def ask(body: bytes) -> None:
            self._to_host.get(key, answer, payload=body, timeout=_REPLY_S, express=True)

        body = b"" if query.payload is None else query.payload.to_bytes()
        self._send((TO_HOST, name), body, ask)

    def _send(self, stream: tuple[str, str], body: bytes, deliver: Deliver) -> None:
        """Draw the faults of a message, and schedule its delivery."""
        with self._lock:
            if stream not in self._rngs:
                key = zlib.crc32(" ".join(stream).encode())
                self._rngs[stream] = np.random.default_rng([self._seed, key])
            rng, faults = self._rngs[stream], self.faults
            dropped, swapped, doubled, cut = rng.random(4) < (
                faults.drop,
                faults.swap,
                faults.duplicate,
                faults.truncate,
            )
            delays_s = rng.uniform(*faults.delay_ms, 2) / 1e3
            length = int(rng.random() * len(body))
            if self.partitioned or dropped:
                self.suffered["partition" if self.partitioned else "drop"] += 1
                return
            if cut:
                self.suffered["truncate"] += 1
                body = body[:length]
            message = _Once(lambda: self._deliver(stream, body, deliver))
            held = self._overtaken.pop(stream, None)
            if swapped and held is None:
                self.suffered["swap"] += 1
                self._overtaken[stream] = message
                self._timetable.add(delays_s[0] + _OVERTAKEN_S, message)
            else:
                self._timetable.add(delays_s[0], message)
            if held is not None:
                self._timetable.add(delays_s[0], held)
            if doubled:
                self.suffered["duplicate"] += 1
                again = _Once(lambda: self._deliver(stream, body, deliver))
                self._timetable.add(delays_s[1], again)

    def _deliver(self, stream: tuple[str, str], body: bytes, deliver: Deliver) -> None:
        if self.partitioned:
            self.suffered["partition"] += 1
            return
        deliver(body)
        self.passed[stream] += 1

    def _start(self, source: Any, take: Callable[[Any], None]) -> None:
        def run() -> None:
            try:
                for each in source:
                    take(each)
            except zenoh.ZError:
                return  # the session was closed

        threading.Thread(target=run, daemon=True, name="faulty link").start()


class _Once:
    """A function that runs on the first call only."""

    def __init__(self, happen: Callable[[], None]) -> None:
        self._happen: Callable[[], None] | None = happen

    def __call__(self) -> None:
        happen, self._happen = self._happen, None
        if happen is not None:
            happen()


class _Timetable:
    """Runs functions at their time, in one thread; those of equal times in their order."""

    def __init__(self) -> None:
        self._waiting: list[tuple[float, int, _Once]] = []
        self._number = itertools.count()
        self._changed = threading.Condition()
        self._over = False
        self._thread = threading.Thread(target=self._run, daemon=True, name="faulty link times")
        self._thread.start()

    def add(self, delay_s: float, call: _Once) -> None:
        with self._changed:
            entry = (time.monotonic() + delay_s, next(self._number), call)
            heapq.heappush(self._waiting, entry)
            self._changed.notify()

    def close(self) -> None:
        with self._changed:
            self._over = True
            self._changed.notify()
        self._thread.join(5.0)

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._over and (
                    not self._waiting or self._waiting[0][0] > time.monotonic()
                ):
                    left_s = self._waiting[0][0] - time.monotonic() if self._waiting else None
                    self._changed.wait(left_s)
                if self._over:
                    return
                call = heapq.heappop(self._waiting)[2]
            try:
                call()
            except zenoh.ZError:
                continue  # its receiver is gone
