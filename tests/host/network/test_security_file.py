"""Security files and endpoints with which a host refuses to listen."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from iher_robot.errors import UserError
from iher_robot.host.network.access import gateway_config
from iher_robot.host.network.certificates import make_certificates
from iher_robot.host.network.security import HostSecurity, read_security

LOOPBACK = ("tcp/127.0.0.1:7447", "tcp/127.8.0.1:1", "tcp/[::1]:7447", "tcp/localhost:7447")
BEYOND = ("tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/10.0.0.7:7447", "tcp/robot.example:7447")


@pytest.fixture
def tls(tmp_path: Path) -> HostSecurity:
    make_certificates(tmp_path / "certs")
    security = read_security(tmp_path / "certs/host/security.yaml")
    assert security is not None
    return security


@pytest.fixture
def users(tmp_path: Path) -> HostSecurity:
    security = _read(tmp_path, "users: users\nroles: {operator: [anna]}\n", users="anna:secret\n")
    assert security is not None
    return security


def _read(
    folder: Path, content: str, users: str | bytes | None = None, mode: int = 0o600
) -> HostSecurity | None:
    if users is not None:
        path = folder / "users"
        path.write_bytes(users if isinstance(users, bytes) else users.encode())
        path.chmod(mode)
    (folder / "security.yaml").write_text(content)
    return read_security(folder / "security.yaml")


@pytest.mark.parametrize("endpoint", LOOPBACK)
def test_loopback_needs_no_security(endpoint: str) -> None:
    gateway_config("fetch", [endpoint], None, insecure=False)


@pytest.mark.parametrize("endpoint", BEYOND)
def test_the_network_needs_security_or_insecure(endpoint: str, users: HostSecurity) -> None:
    for listen in ([endpoint], [LOOPBACK[0], endpoint]):
        with pytest.raises(UserError, match=r"--security FILE .*--insecure"):
            gateway_config("fetch", listen, None, insecure=False)
    gateway_config("fetch", [endpoint], None, insecure=True)
    gateway_config("fetch", [endpoint], users, insecure=False)


def test_a_tls_endpoint_needs_certificates(users: HostSecurity, tls: HostSecurity) -> None:
    for security in (None, users):
        with pytest.raises(UserError, match="no certificates"):
            gateway_config("fetch", ["tls/127.0.0.1:1"], security, insecure=True)
    gateway_config("fetch", ["tls/0.0.0.0:1"], tls, insecure=False)


def test_a_tcp_endpoint_with_roles_needs_users(tls: HostSecurity) -> None:
    with pytest.raises(UserError, match="clients have no certificate; listen on tls/127"):
        gateway_config("fetch", ["tcp/127.0.0.1:1"], tls, insecure=False)


@pytest.mark.parametrize(
    "endpoint", ["127.0.0.1:7447", "udp/127.0.0.1:7447", "tcp/127.0.0.1", "tcp/a:0", "tcp/a:65536"]
)
def test_an_endpoint_is_tcp_or_tls(endpoint: str) -> None:
    with pytest.raises(UserError, match="allowed: tcp/HOST:PORT or tls/HOST:PORT"):
        gateway_config("fetch", [endpoint], None, insecure=True)


def test_a_host_listens_somewhere() -> None:
    with pytest.raises(UserError, match="no endpoint"):
        gateway_config("fetch", [], None, insecure=False)


def test_no_file_is_no_security() -> None:
    assert read_security(None) is None


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("", "give tls, users or both"),
        ("roles: {operator: [anna]}", "give tls, users or both"),
        ("users: users", "no client has a role"),
        ("users: users\nroles: {operator: []}", "no client has a role"),
        ("users: users\nroles: {operator: ['']}", "roles.operator has an empty name"),
        ("users: users\nroles: {operators: [anna]}", "did you mean 'roles.operator'"),
        ("user: users", "did you mean 'users'"),
        ("tls: {ca: a, certificates: b, key: c}", "did you mean 'tls.certificate'"),
        ("tls: {ca: a}\nroles: {viewer: [anna]}", "tls.certificate"),
        ("users: users\nroles: {operator: anna}", "roles.operator is 'anna'"),
        ("users: users\nroles: {operator: [ana]}", "did you mean 'anna'"),
        ("users: missing\nroles: {operator: [anna]}", "no file of users"),
        ("tls: {ca: a, certificate: b, key: c}\nroles: {viewer: [anna]}", "tls.ca"),
        ("- users", "expected lines of"),
    ],
)
def test_a_contradictory_file_is_refused(tmp_path: Path, content: str, sentence: str) -> None:
    with pytest.raises(UserError) as error:
        _read(tmp_path, content, users="anna:secret\n")
    assert sentence in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("users", "sentence"),
    [
        ("anna\n", "line 1: allowed: user:password"),
        ("\nanna:\n", "line 2: allowed: user:password"),
        (":secret\n", "line 1: allowed: user:password"),
        ("anna:a\nanna:b\n", "line 2: 'anna' appears twice"),
        ("\n", "is empty"),
        (b"\xff:\xff\n", "not UTF-8"),
    ],
)
def test_a_file_of_users_is_checked_and_not_shown(
    tmp_path: Path, users: str | bytes, sentence: str
) -> None:
    with pytest.raises(UserError, match=sentence):
        _read(tmp_path, "users: users\nroles: {operator: [anna]}\n", users)


def test_readable_passwords_log_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    content = "users: users\nroles: {operator: [anna]}\n"
    with caplog.at_level(logging.WARNING):
        _read(tmp_path, content, "anna:secret\n", mode=0o600)
        assert not caplog.messages
        _read(tmp_path, content, "anna:secret\n", mode=0o640)
    assert [message for message in caplog.messages if "chmod 600" in message]
    assert "secret" not in caplog.text
