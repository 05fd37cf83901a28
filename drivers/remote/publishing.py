"""Publishing for a control loop: the newest counts, and nothing waits."""

from __future__ import annotations

import zenoh


def real_time_publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    """Declare a publisher that sends at once, before anything else, and drops when congested.

    Args:
        session: Of either side.
        key: What it publishes on.
    """
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=zenoh.Priority.REAL_TIME,
        express=True,
    )
