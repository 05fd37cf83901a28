"""A fake host behind real access control, and clients that try every message."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Self

import zenoh

from drivers.closing import Closing
from drivers.remote.keys import REQUESTS, robot_key
from drivers.remote.link import LinkOptions, client_config, link_options, open_session
from iher_robot.host.network.access import gateway_config
from iher_robot.host.network.certificates import issue, make_authority, make_certificates
from iher_robot.host.network.security import HostSecurity, read_security
from tests.served.served_robot import eventually, free_port

ROBOT = "fetch"
ROLES = ("operator", "learner", "viewer", "perception")
STRANGER = "stranger"
PATIENCE_S = 3.0


def key(*parts: str) -> str:
    return robot_key(ROBOT, *parts)


@dataclass(frozen=True)
class Site:
    """Endpoint and security of a host, and the options with which each name logs in."""

    endpoint: str
    security: HostSecurity | None
    options: Callable[[str], LinkOptions]
    stranger: str
    """Name of a client that can log in and has no role."""


def certified_site(folder: Path) -> Site:
    make_certificates(folder / "certs", names=(*ROLES, STRANGER))
    security = folder / "certs/host/security.yaml"
    security.write_text(security.read_text().replace("  - stranger\n", ""))
    endpoint = f"tls/127.0.0.1:{free_port()}"

    def options(name: str) -> LinkOptions:
        side = folder / "certs" / name
        return tls_options(endpoint, side / "ca.pem", side / "certificate.pem", side / "key.pem")

    return Site(endpoint, read_security(security), options, STRANGER)


def tls_options(endpoint: str, ca: Path, certificate: Path, private_key: Path) -> LinkOptions:
    tls = {"ca": ca, "certificate": certificate, "key": private_key}
    return link_options({"connect": [endpoint], "tls": tls, "connect_timeout_s": 1.0})


def forged_options(folder: Path, endpoint: str) -> LinkOptions:
    """Return options with an operator's certificate of another authority."""
    forged = issue(make_authority(), "operator")
    certificate, private_key = folder / "forged.pem", folder / "forged-key.pem"
    certificate.write_bytes(forged.certificate_pem())
    private_key.write_bytes(forged.key_pem())
    return tls_options(endpoint, folder / "certs/operator/ca.pem", certificate, private_key)


def password_site(folder: Path) -> Site:
    names = (*ROLES, STRANGER)
    _secret(folder / "users", "".join(f"{name}:of the {name}\n" for name in names))
    roles = "".join(f"  {role}: [{role}]\n" for role in ROLES)
    (folder / "security.yaml").write_text(f"users: users\nroles:\n{roles}")
    endpoint = f"tcp/127.0.0.1:{free_port()}"

    def options(name: str) -> LinkOptions:
        return password_options(folder, endpoint, name, f"of the {name}")

    return Site(endpoint, read_security(folder / "security.yaml"), options, STRANGER)


def password_options(folder: Path, endpoint: str, user: str, password: str) -> LinkOptions:
    path = folder / f"{user}.password"
    _secret(path, password + "\n")
    return link_options(
        {"connect": [endpoint], "user": user, "password_file": path, "connect_timeout_s": 1.0}
    )


def open_site() -> Site:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    options = link_options({"connect": [endpoint], "connect_timeout_s": 1.0})
    return Site(endpoint, None, lambda _: options, "")


def connect(options: LinkOptions, mode: str = "peer") -> zenoh.Session:
    """Connect as `open_session` does, or in another mode of Zenoh, as an attacker could."""
    if mode == "peer":
        return open_session(options)
    config = client_config(options)
    config.insert_json5("mode", json.dumps(mode))
    return zenoh.open(config)


@dataclass
class FakeHost(Closing):
    """Records what reaches it, and answers every request with ``host``."""

    site: Site
    access_control: bool = True
    received: list[tuple[str, bytes]] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)

    def __enter__(self) -> Self:
        config = gateway_config(ROBOT, [self.site.endpoint], self.site.security, insecure=False)
        if not self.access_control:
            config.insert_json5("access_control", json.dumps({"enabled": False}))
        self.session = zenoh.open(config)
        self.alive = self.session.liveliness().declare_token(key("alive", "host"))
        self._declared = [
            self.session.declare_subscriber(key(*name.split("/")), self._receive)
            for name in ("cmd", "stop", "object/*")
        ]
        self._queryable = self.session.declare_queryable(key("rpc", "*"), self._answer)
        return self

    def close(self) -> None:
        self.session.close()

    def stopped_by(self, client: zenoh.Session, mark: bytes) -> bool:
        """Send a stop; return whether it arrives, and so every message sent before it."""
        client.put(key("stop"), mark)
        return eventually(lambda: ("stop", mark) in self.received, PATIENCE_S)

    def _receive(self, sample: zenoh.Sample) -> None:
        name = str(sample.key_expr).removeprefix(key() + "/")
        self.received.append((name, sample.payload.to_bytes()))

    def _answer(self, query: zenoh.Query) -> None:
        self.asked.append(str(query.key_expr).rsplit("/", 1)[-1])
        with query:
            query.reply(query.key_expr, b"host")


def goes_through(host: FakeHost, client: zenoh.Session, patience_s: float = PATIENCE_S) -> set[str]:
    """Send every message, those that are always allowed last, and return those with an effect."""
    host.received.clear()
    host.asked.clear()
    states: list[bytes] = []
    answered: set[str] = set()
    subscriber = client.declare_subscriber(
        key("state"), lambda sample: states.append(sample.payload.to_bytes())
    )
    for name in ("cmd", "object/object0", "state", "fault", "rpc/spec", "stop"):
        client.put(key(*name.split("/")), b"put")
    for name in sorted(REQUESTS, key=("ping", "spec", "status", "stop").__contains__):
        client.get(key("rpc", name), partial(_note, name, answered))

    def publish_until_seen() -> bool:
        host.session.put(key("state"), b"state")
        return b"state" in states  # and not only a state that the client published itself

    eventually(lambda: ("stop", b"put") in host.received, patience_s)
    eventually(lambda: answered >= set(host.asked) and "stop" in answered, patience_s)
    eventually(publish_until_seen, patience_s)
    subscriber.undeclare()
    assert answered == set(host.asked)
    put = {f"put {name}" for name, _ in host.received}
    return put | {f"rpc {name}" for name in answered} | ({"state"} if b"state" in states else set())


def _note(name: str, answered: set[str], reply: zenoh.Reply) -> None:
    if reply.ok is not None and reply.ok.payload.to_bytes() == b"host":
        answered.add(name)


def _secret(path: Path, content: str) -> None:
    path.touch(0o600)
    path.write_text(content)
