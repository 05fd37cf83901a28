"""Floods a host with messages that it must refuse: ``python -m tests.served.flooder ENDPOINT N``.

It prints how many it sent, by the reason for which the host must refuse them, as JSON.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterable

import numpy as np
import zenoh

from drivers.remote.client import RobotClient
from drivers.remote.link import link_options
from tests.served.hostile import Hostile, HostileMessages
from tests.served.observer import Observer

PER_SECOND = 5000
_AT_ONCE = 50
_PREFIX = "iher/v1/fetch/"


def main(endpoint: str, count: str, per_second: str = str(PER_SECOND)) -> None:
    with Observer(endpoint) as observer:
        info = observer.newest[1]
    messages = HostileMessages(np.random.default_rng(5), info.boot, info.token)
    other = HostileMessages(np.random.default_rng(6), info.boot, info.token)
    n = int(count)
    sent: Counter[str] = Counter()
    with RobotClient(link_options({"connect": [endpoint], "timeout_s": 10.0})) as client:
        session = client._session
        asking = threading.Thread(target=_ask, args=(session, other.requests(n // 50), sent))
        asking.start()
        stream = (messages.poses, messages.stops)
        few = [list(make(n // 25)) for make in stream]
        commands = n - n // 50 - 2 * (n // 25)
        _put(session, messages.commands(commands), few, int(per_second), sent)
        asking.join()
        next(iter(session.get(_PREFIX + "rpc/status", payload=b"\x81\xa1v\x01", timeout=30.0)))
    sys.stdout.write(json.dumps(sent) + "\n")


def _put(
    session: zenoh.Session,
    commands: Iterable[Hostile],
    few: list[list[Hostile]],
    per_second: int,
    sent: Counter[str],
) -> None:
    publishers = {
        key: session.declare_publisher(
            _PREFIX + key, congestion_control=zenoh.CongestionControl.BLOCK
        )
        for key in ("cmd", "object/object0", "stop")
    }
    begun = time.monotonic()
    for i, message in enumerate(commands):
        batch = [message]
        if i % 20 == 0:
            batch += [waiting.pop() for waiting in few if waiting]
        for each in batch:
            publishers[each.key].put(each.body)
            sent[each.reason] += 1
        ahead_s = i / per_second - (time.monotonic() - begun)
        if i % _AT_ONCE == 0 and ahead_s > 0:
            time.sleep(ahead_s)
    for rest in few:
        for each in rest:
            publishers[each.key].put(each.body)
            sent[each.reason] += 1
    sys.stderr.write(f"{time.monotonic() - begun:.1f} s\n")


def _ask(session: zenoh.Session, requests: Iterable[Hostile], sent: Counter[str]) -> None:
    for request in requests:
        sent[request.reason] += 1
        for _ in session.get(_PREFIX + request.key, payload=request.body, timeout=10.0):
            pass


if __name__ == "__main__":
    main(*sys.argv[1:])
