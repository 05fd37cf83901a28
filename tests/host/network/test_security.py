"""Who gets what through, over real sessions on loopback."""

from __future__ import annotations

from collections.abc import Iterator
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
    eventually,
    forged_options,
    goes_through,
    key,
    open_site,
    password_options,
    password_site,
)

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
def test_a_role_gets_through_exactly_what_it_may(host: FakeHost, role: str) -> None:
    with open_session(host.site.options(role)) as client:
        assert goes_through(host, client) == MAY[role]


def test_who_has_no_role_gets_nothing_through(host: FakeHost) -> None:
    with open_session(host.site.options(host.site.stranger)) as client:
        assert goes_through(host, client, patience_s=0.3) == set()


def test_who_cannot_log_in_has_no_link(host: FakeHost, folder: Path) -> None:
    endpoint = host.site.endpoint
    if endpoint.startswith("tls/"):
        refused = [forged_options(folder, endpoint)]
    else:
        refused = [
            password_options(folder, endpoint, "operator", "wrong"),
            password_options(folder, endpoint, "nobody", "of the nobody"),
            link_options({"connect": [endpoint], "connect_timeout_s": 1.0}),
        ]
    for options in refused:
        with pytest.raises(LinkLost, match="credentials"):
            open_session(options)
    assert host.session.info.links() == []


@pytest.mark.parametrize("mode", ["peer", "client"])
def test_another_spelling_of_a_key_opens_nothing(host: FakeHost, mode: str) -> None:
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


# An attacker may run Zenoh as he likes; for a `client`, a host would pass on messages.
@pytest.mark.parametrize("mode", ["peer", "client"])
class TestClientsOfOneHost:
    def test_cannot_pass_for_it_with_a_state(self, host: FakeHost, mode: str) -> None:
        with _two(host, mode) as (viewer, victim):
            assert _states_heard(host, viewer, victim) == {b"of the host"}

    def test_cannot_answer_for_it(self, host: FakeHost, mode: str) -> None:
        with _two(host, mode) as (viewer, victim):
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

    def test_cannot_stand_in_for_its_life(self, host: FakeHost, mode: str) -> None:
        def lives(name: str) -> bool:
            return any(reply.ok for reply in victim.liveliness().get(key("alive", name)))

        with _two(host, mode) as (viewer, victim):
            assert eventually(lambda: lives("host"))
            token = viewer.liveliness().declare_token(key("alive", "host"))
            assert host.stopped_by(viewer, b"after living")
            host.alive.undeclare()
            try:
                assert eventually(lambda: not lives("host"))
            finally:
                host.alive = host.session.liveliness().declare_token(key("alive", "host"))
            token.undeclare()

    def test_show_it_that_they_live(self, host: FakeHost, mode: str) -> None:
        with _two(host, mode) as (viewer, _):
            token = viewer.liveliness().declare_token(key("alive", "somebody"))
            assert eventually(lambda: any(host.session.liveliness().get(key("alive", "somebody"))))
            token.undeclare()


def test_access_control_is_what_stops_a_false_state(folder: Path) -> None:
    host = FakeHost(password_site(folder), access_control=False)
    with host, _two(host, "client") as (viewer, victim):
        assert b"false" in _states_heard(host, viewer, victim)


def test_without_security_anybody_commands_and_nobody_passes_for_the_host() -> None:
    with FakeHost(open_site()) as host:
        with open_session(host.site.options("")) as client:
            assert goes_through(host, client) == MAY["operator"]
        with _two(host, "client") as (viewer, victim):
            assert _states_heard(host, viewer, victim) == {b"of the host"}


class _two:  # noqa: N801 - reads as a function
    """A viewer and a learner."""

    def __init__(self, host: FakeHost, mode: str) -> None:
        self._sessions = [connect(host.site.options(name), mode) for name in ("viewer", "learner")]

    def __enter__(self) -> tuple[zenoh.Session, zenoh.Session]:
        viewer, learner = self._sessions
        return viewer, learner

    def __exit__(self, *_: object) -> None:
        for session in self._sessions:
            session.close()


def _states_heard(host: FakeHost, viewer: zenoh.Session, victim: zenoh.Session) -> set[bytes]:
    """Let a viewer publish a state, then the host, and return what another client hears."""
    heard: list[bytes] = []
    subscriber = victim.declare_subscriber(
        key("state"), lambda sample: heard.append(sample.payload.to_bytes())
    )

    def publish() -> bool:
        host.session.put(key("state"), b"of the host")
        return b"of the host" in heard

    assert eventually(publish)
    for name in ("state", "*", "**"):
        viewer.put(f"{key()}/{name}", b"false")
    assert host.stopped_by(viewer, b"after the false state")
    before = len(heard)
    assert eventually(lambda: publish() and len(heard) > before)
    subscriber.undeclare()
    return set(heard)
