"""Round-trip times of the link to a robot."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from drivers.errors import LinkLost
from drivers.remote.client import RobotClient
from drivers.remote.messages import Ping


@dataclass(frozen=True)
class LinkQuality:
    """Round trips between a client and a robot's control loop.

    Attributes:
        count: Number of round trips attempted.
        lost: Number of those without a reply in time.
        p50_ms: Median.
        p99_ms: 99th percentile.
        jitter_ms: Standard deviation.
    """

    count: int
    lost: int
    p50_ms: float
    p99_ms: float
    jitter_ms: float


def measure_link(client: RobotClient, count: int, pause_s: float = 0.01) -> LinkQuality:
    """Measure round trips, one after the other.

    Args:
        client: Session with the host.
        count: Number of round trips.
        pause_s: Pause between two of them.

    Raises:
        LinkLost: The first one got no reply.
    """
    times_ms: list[float] = []
    lost: LinkLost | None = None
    for _ in range(count):
        begun = time.perf_counter()
        try:
            client.request("ping", Ping(payload=bytes(500)))
        except LinkLost as error:
            lost = error
            if not times_ms:
                raise
            continue
        times_ms.append(1e3 * (time.perf_counter() - begun))
        time.sleep(pause_s)
    assert times_ms or lost is not None
    p50, p99 = np.percentile(times_ms, [50, 99])
    return LinkQuality(
        count, count - len(times_ms), float(p50), float(p99), float(np.std(times_ms))
    )
