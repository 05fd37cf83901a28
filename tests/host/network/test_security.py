"""Rights of each role, over real sessions on loopback."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zenoh

from drivers.errors import LinkLost
from drivers.remote.keys import REQUESTS
from drivers.remote.link import link_options, open_session
from tests.served.secured import (
    ROLES,
    FakeHost,
    certified_site,
    connect,
    forged_options,
    goes_through,
    key,
    open_site,
    password_options,
    password_site,
)
from tests.served.served_robot import eventually

WATCH = {"state", "put stop", "rpc spec", "rpc status", "rpc ping", "rpc stop"}
MOVE = {"put cmd", "rpc lease", "rpc arm", "rpc disarm", "rpc reset", "rpc hands_clear"}
SEE = {"put object/object0"}
MAY = {
    "operator": WATCH | MOVE | SEE | {"rpc clear_fault"},
    "learner": WATCH | MOVE,
    "viewer": WATCH,
    "perception": WATCH | SEE,
}

SECURED = {"certificates": certified_site, "passwords": password_site}


@pytest.fixture(scope="module")
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("secured")


@pytest.fixture(scope="module", params=SECURED)
def host(request: pytest.FixtureRequest, folder: Path) -> Iterator[FakeHost]:
    with FakeHost(SECURED[request.param](folder)) as host:
        yield host


def test_the_roles_cover_every_request() -> None:
    assert {f"rpc {name}" for name in REQUESTS} <= MAY["operator"]


@pytest.mark.parametrize("role", ROLES)
def test_each_role_has_exactly_its_rights(host: FakeHost, role: str) -> None:
    with open_session(host.site.options(role)) as client:
        assert goes_through(host, client) == MAY[role]


def test_a_client_without_a_role_has_no_rights(host: FakeHost) -> None:
    with open_session(host.site.options(host.site.stranger)) as client:
        assert goes_through(host, client, patience_s=0.3) == set()


def test_a_client_that_cannot_log_in_has_no_link(host: FakeHost, folder: Path) -> None:
    endpoint = host.site.endpoint
    if endpoint.startswith("tls/"):
        refused = [forged_options(folder, endpoint)]
    else:
        refused = [
            password_options(folder, endpoint, "operator", "wrong"),
            password_options(folder, endpoint, "unknown", "of the unknown"),
            link_options({"connect": [endpoint], "connect_timeout_s": 1.0}),
        ]
    for options in refused:
        with pytest.raises(LinkLost, match="credentials"):
            open_session(options)
    assert host.session.info.links() == []


@pytest.mark.parametrize("mode", ["peer", "client"])
def test_other_spellings_of_a_key_grant_no_rights(host: FakeHost, mode: str) -> None:
    with connect(host.site.options("viewer"), mode) as viewer:
        host.received.clear()
        host.asked.clear()
        for pattern in ("*", "rpc/*", "rpc/a$*", "**/arm", "rpc/arm/**"):
            viewer.get(f"{key()}/{pattern}", lambda reply: None)
        for pattern in ("*", "**", "cmd/**", "object/*", "*/object0"):
            viewer.put(f"{key()}/{pattern}", b"")
            viewer.delete(f"{key()}/{pattern}")
        viewer.delete(key("stop"))
        viewer.put(viewer.declare_keyexpr(key("cmd")), b"")
        viewer.put(viewer.declare_keyexpr(key()).join("cmd"), b"")
        viewer.declare_publisher(key("cmd")).put(b"")
        viewer.declare_querier(key("rpc", "arm")).get(handler=lambda reply: None)
        assert host.stopped_by(viewer, b"at last")
        assert host.received == [("stop", b"at last")]
        assert host.asked == []


# An attacker may use any mode of Zenoh; from a `client`, a host would forward messages.
@pytest.mark.parametrize("mode", ["peer", "client"])
class TestClientsOfOneHost:
    def test_cannot_publish_a_state_as_the_host(self, host: FakeHost, mode: str) -> None:
        with _two_clients(host, mode) as (viewer, victim):
            assert _states_received(host, viewer, victim) == {b"of the host"}

    def test_cannot_answer_requests_as_the_host(self, host: FakeHost, mode: str) -> None:
        with _two_clients(host, mode) as (viewer, victim):
            declared = [
                viewer.declare_queryable(key("rpc", name), lambda q: q.reply(q.key_expr, b"viewer"))
                for name in ("spec", "*")
            ]
            assert host.stopped_by(viewer, b"after declaring")
            replies = victim.get(
                key("rpc", "spec"),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=1.0,
            )
            answers = [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]
            assert answers == [b"host"]
            assert declared

    def test_cannot_declare_the_liveliness_of_the_host(self, host: FakeHost, mode: str) -> None:
        def lives(name: str) -> bool:
            return any(reply.ok for reply in victim.liveliness().get(key("alive", name)))

        with _two_clients(host, mode) as (viewer, victim):
            assert eventually(lambda: lives("host"))
            token = viewer.liveliness().declare_token(key("alive", "host"))
            assert host.stopped_by(viewer, b"after living")
            host.alive.undeclare()
            try:
                assert eventually(lambda: not lives("host"))
            finally:
                host.alive = host.session.liveliness().declare_token(key("alive", "host"))
            token.undeclare()

    def test_can_declare_their_own_liveliness(self, host: FakeHost, mode: str) -> None:
        with _two_clients(host, mode) as (viewer, _):
            token = viewer.liveliness().declare_token(key("alive", "viewer-1"))
            assert eventually(lambda: any(host.session.liveliness().get(key("alive", "viewer-1"))))
            token.undeclare()


def test_access_control_prevents_false_states(folder: Path) -> None:
    host = FakeHost(password_site(folder), access_control=False)
    with host, _two_clients(host, "client") as (viewer, victim):
        assert b"false" in _states_received(host, viewer, victim)


def test_without_security_all_clients_command_and_none_impersonates_the_host() -> None:
    with FakeHost(open_site()) as host:
        with open_session(host.site.options("")) as client:
            assert goes_through(host, client) == MAY["operator"]
        with _two_clients(host, "client") as (viewer, victim):
            assert _states_received(host, viewer, victim) == {b"of the host"}


@contextmanager
def _two_clients(host: FakeHost, mode: str) -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    """Yield a viewer and a learner."""
    with (
        connect(host.site.options("viewer"), mode) as viewer,
        connect(host.site.options("learner"), mode) as learner,
    ):
        yield viewer, learner


def _states_received(host: FakeHost, viewer: zenoh.Session, victim: zenoh.Session) -> set[bytes]:
    """Publish states as a viewer and as the host; return those that another client received."""
    received: list[bytes] = []
    subscriber = victim.declare_subscriber(
        key("state"), lambda sample: received.append(sample.payload.to_bytes())
    )

    def publish() -> bool:
        host.session.put(key("state"), b"of the host")
        return b"of the host" in received

    assert eventually(publish)
    for name in ("state", "*", "**"):
        viewer.put(f"{key()}/{name}", b"false")
    assert host.stopped_by(viewer, b"after the false state")
    before = len(received)
    assert eventually(lambda: publish() and len(received) > before)
    subscriber.undeclare()
    return set(received)
