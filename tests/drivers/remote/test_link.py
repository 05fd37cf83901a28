"""Options of a link, credentials, and connecting."""

from __future__ import annotations

import json
import logging
import socket
import threading
import time
from pathlib import Path

import pytest
import zenoh

from drivers.errors import InvalidSpec, LinkLost
from drivers.remote.link import LinkOptions, link_options, open_session
from iher_robot.host.network.certificates import make_certificates
from tests.served.secured import FakeHost, key, open_site
from tests.served.served_robot import eventually, free_port

CONNECT_TIMEOUT_S = 0.5


def _options(*endpoints: str) -> LinkOptions:
    return link_options({"connect": list(endpoints), "connect_timeout_s": CONNECT_TIMEOUT_S})


def test_every_option_has_a_default() -> None:
    options = link_options({})
    assert (options.robot, options.connect) == ("fetch", ("tcp/127.0.0.1:7447",))


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"conect": ["tcp/a:1"]}, "did you mean 'connect'"),
        ({"tls": {"ca": "a", "certificate": "b", "keys": "c"}}, "did you mean 'tls.key'"),
        ({"robot": "Fetch 1"}, "remote robot setting robot is 'Fetch 1'"),
        ({"connect": []}, "remote robot setting connect is []"),
        ({"connect": "tcp/a:1"}, "remote robot setting connect is 'tcp/a:1'"),
        ({"connect": ["a:1"]}, "'a:1', allowed: tcp/HOST:PORT or tls/HOST:PORT"),
        ({"connect": ["udp/a:1"]}, "allowed: tcp/HOST:PORT or tls/HOST:PORT"),
        ({"connect": ["tcp/a:1#iface=eth0"]}, "allowed: tcp/HOST:PORT or tls/HOST:PORT"),
        ({"connect": ["tcp/a:99999"]}, "allowed: tcp/HOST:PORT or tls/HOST:PORT"),
        ({"connect": ["tls/a:1"]}, "needs certificates"),
        ({"timeout_s": 0}, "remote robot setting timeout_s is 0"),
        ({"connect_timeout_s": float("nan")}, "setting connect_timeout_s"),
        ({"user": "anna"}, "give both"),
        ({"password_file": "secret"}, "give both"),
    ],
)
def test_a_wrong_option_is_one_sentence(options: dict[str, object], sentence: str) -> None:
    with pytest.raises(InvalidSpec) as error:
        link_options(options)
    assert sentence in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (None, "No such file"),
        (b"", "has 0 lines"),
        (b"\n", "allowed: one"),
        (b"first\nsecond\n", "has 2 lines"),
        (b"\xff", "not UTF-8"),
    ],
)
def test_a_password_is_one_line(tmp_path: Path, content: bytes | None, sentence: str) -> None:
    path = tmp_path / "password"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InvalidSpec, match=sentence) as error:
        open_session(link_options({"user": "anna", "password_file": path}))
    assert "second" not in str(error.value)


def test_a_readable_password_logs_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "password"
    path.write_text("secret\n")
    path.chmod(0o644)
    options = _options(f"tcp/127.0.0.1:{free_port()}").model_copy(
        update={"user": "anna", "password_file": path}
    )
    with caplog.at_level(logging.WARNING), pytest.raises(LinkLost, match="credentials"):
        open_session(options)
    assert f"chmod 600 {path}" in caplog.text
    assert "secret" not in caplog.text


def test_certificates_are_checked_before_connecting(tmp_path: Path) -> None:
    make_certificates(tmp_path, names=("operator", "viewer"))
    side, other = tmp_path / "operator", tmp_path / "viewer"
    good = {"ca": side / "ca.pem", "certificate": side / "certificate.pem", "key": side / "key.pem"}
    for wrong, sentence in (
        ({"ca": side / "robot.yaml"}, "tls.ca .* holds no PEM certificate"),
        ({"certificate": side / "missing.pem"}, "tls.certificate .* cannot be read"),
        ({"key": side / "certificate.pem"}, "tls.key .* holds no PEM private key"),
        ({"key": other / "key.pem"}, "tls.key .* is not the key of tls.certificate"),
    ):
        options = link_options({"connect": ["tls/127.0.0.1:1"], "tls": good | wrong})
        with pytest.raises(InvalidSpec, match=sentence):
            open_session(options)


def test_the_error_without_a_host_says_how_to_start_one() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with pytest.raises(LinkLost) as error:
        open_session(_options(endpoint))
    assert endpoint in str(error.value)
    assert "iher-robot serve --driver mujoco" in str(error.value)


def test_a_host_that_never_answers_is_given_up() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        endpoint = f"tcp/127.0.0.1:{silent.getsockname()[1]}"
        raised = threading.Event()

        def attempt() -> None:
            with pytest.raises(LinkLost):
                open_session(_options(endpoint, endpoint, endpoint))
            raised.set()

        threading.Thread(target=attempt, daemon=True).start()
        assert raised.wait(CONNECT_TIMEOUT_S + 1.0)


def test_endpoints_are_tried_in_turn() -> None:
    site = open_site()
    with FakeHost(site):
        unused = f"tcp/127.0.0.1:{free_port()}"
        for endpoints in ((unused, site.endpoint), (site.endpoint, unused)):
            with open_session(_options(*endpoints)) as session:
                assert [str(link.dst) for link in session.info.links()] == [site.endpoint]


def test_a_client_does_not_listen_and_finds_only_the_host() -> None:
    site = open_site()
    with (
        FakeHost(site) as host,
        open_session(site.options("")) as one,
        open_session(site.options("")) as other,
    ):
        for session in (one, other):
            assert [str(link.zid) for link in session.info.links()] == [str(host.session.zid())]


def test_a_client_reconnects_when_the_host_returns() -> None:
    site = open_site()
    with FakeHost(site) as first:
        session = open_session(site.options(""))
        assert first.stopped_by(session, b"before")
    with session:
        assert eventually(lambda: not session.info.links())
        # Longer than the connect timeout, so that reconnecting is tested and not connecting.
        time.sleep(1.2)
        with FakeHost(site) as second:
            assert eventually(lambda: _stops(second, session))


def _stops(host: FakeHost, session: zenoh.Session) -> bool:
    session.put(key("stop"), b"after")
    return ("stop", b"after") in host.received


def test_a_zenoh_peer_without_links_is_no_host() -> None:
    """A peer that refuses all sessions: no session without a link is returned."""
    config = zenoh.Config()
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    for name, value in {
        "mode": "peer",
        "listen/endpoints": [endpoint],
        "scouting/multicast/enabled": False,
        "transport/unicast/max_sessions": 0,
    }.items():
        config.insert_json5(name, json.dumps(value))
    with zenoh.open(config), pytest.raises(LinkLost):
        open_session(_options(endpoint))
