"""Zenoh publishers for control loops: low latency, dropping instead of blocking."""

from __future__ import annotations

import zenoh


def real_time_publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    """Declare a publisher that sends immediately, at the highest priority, and drops if congested.

    Args:
        session: Session of a host or a client.
        key: Key to publish on.
    """
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=zenoh.Priority.REAL_TIME,
        express=True,
    )
