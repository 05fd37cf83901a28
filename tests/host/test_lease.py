"""The lease of a robot, and the silence timer."""

from __future__ import annotations

import pytest

from drivers import LeaseRefused, SimulatedClock
from iher_robot.host.lease import HostLease, SilenceTimer


@pytest.fixture
def clock() -> SimulatedClock:
    return SimulatedClock(10**9)


@pytest.fixture
def lease(clock: SimulatedClock) -> HostLease:
    return HostLease("fetch", 2.0, clock)


def test_a_second_client_is_refused_with_the_name_of_the_first(lease: HostLease) -> None:
    lease.acquire("a", "ann@lab")
    with pytest.raises(LeaseRefused, match="ann@lab"):
        lease.acquire("b", "ben@lab")
    lease.release()
    lease.acquire("b", "ben@lab")


def test_a_silent_client_loses_the_lease_after_its_time_and_not_before(
    lease: HostLease, clock: SimulatedClock
) -> None:
    token = lease.acquire("a", "ann")
    clock.advance_ns(2 * 10**9)
    assert not lease.expire(), "exactly its time is not beyond it"
    lease.require(token)
    clock.advance_ns(2 * 10**9)
    assert not lease.expire(), "a request of the client renews its lease"
    clock.advance_ns(1)
    assert lease.expire()
    with pytest.raises(LeaseRefused, match="has ended"):
        lease.require(token)


def test_an_old_token_is_refused_also_from_the_client_that_has_the_new_one(
    lease: HostLease,
) -> None:
    old = lease.acquire("a", "ann")
    lease.n = 17
    new = lease.acquire("a", "ann")
    assert new > old, "tokens rise"
    assert lease.n == 0, "commands are numbered anew under each lease"
    with pytest.raises(LeaseRefused):
        lease.require(old)
    lease.require(new)


def test_token_0_is_no_lease(lease: HostLease) -> None:
    with pytest.raises(LeaseRefused):
        lease.require(0)


def test_a_silence_timer_expires_beyond_its_limit(clock: SimulatedClock) -> None:
    deadman = SilenceTimer(0.2, clock)
    clock.advance_ns(200_000_000)
    assert not deadman.expired
    clock.advance_ns(1)
    assert deadman.expired
    deadman.restart()
    assert not deadman.expired
