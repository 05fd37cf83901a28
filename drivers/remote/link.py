"""The link from a client to a robot's host: options, credentials, Zenoh session."""

from __future__ import annotations

import json
import logging
import re
import stat
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import zenoh
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from drivers.errors import InvalidSpec, LinkLost
from drivers.remote.certificates import TlsFiles, check_certificates
from drivers.remote.keys import ROBOT_NAME
from drivers.validation import describe_problems
from drivers.wire import MAX_BYTES

log = logging.getLogger(__name__)

_ENDPOINT = re.compile(r"(tcp|tls)/(\[[0-9a-fA-F:]+\]|[A-Za-z0-9._-]+):(\d{1,5})")

# Peers without scouting: unlike a router, such a host forwards nothing between its clients, and
# clients do not discover each other.
POINT_TO_POINT: Mapping[str, object] = {
    "mode": "peer",
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "transport/link/protocols": ["tcp", "tls"],
    "transport/link/tx/lease": 1000,
    # A request waits for space in the queue; after this time, in microseconds, the link is closed.
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 500_000,
    "transport/link/rx/max_message_size": 2 * MAX_BYTES,
    "transport/shared_memory/enabled": False,
}
"""Zenoh settings that host and clients share."""


def check_endpoint(endpoint: str) -> str:
    """Return a Zenoh endpoint if a robot can be served on it.

    Raises:
        ValueError: If it is malformed, or neither tcp nor tls.
    """
    match = _ENDPOINT.fullmatch(endpoint)
    if match is None or not 1 <= int(match[3]) <= 65535:
        raise ValueError(f"endpoint is {endpoint!r}, allowed: tcp/HOST:PORT or tls/HOST:PORT")
    return endpoint


def _some(endpoints: tuple[str, ...]) -> tuple[str, ...]:
    # Not as a bound of the field, which would also be reported for a wrong endpoint.
    if not endpoints:
        raise ValueError("at least one endpoint is needed, such as tcp/127.0.0.1:7447")
    return endpoints


Endpoint = Annotated[str, AfterValidator(check_endpoint)]
Seconds = Annotated[float, Field(gt=0, le=3600, allow_inf_nan=False)]


class LinkOptions(BaseModel):
    """Address of a remote robot, and credentials: the options of driver ``zenoh``."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    robot: str = Field(default="fetch", pattern=f"^{ROBOT_NAME}$")
    """Name of the robot on the network."""
    connect: Annotated[tuple[Endpoint, ...], AfterValidator(_some)] = ("tcp/127.0.0.1:7447",)
    """Zenoh endpoints of its host, tried in turn."""
    tls: TlsFiles | None = None
    """Certificates; required for a tls endpoint."""
    user: str | None = Field(default=None, min_length=1)
    """User name, if the host requires one."""
    password_file: Path | None = None
    """File whose only line is that user's password."""
    timeout_s: Seconds = 1.0
    """Longest time to wait for a state in a tick, and for a reply, s."""
    connect_timeout_s: Seconds = 3.0
    """Longest time to wait for the host, and for a lease that another client has, s."""
    reset_timeout_s: Seconds = 120.0
    """Longest time to wait for a reset, or for a scene to be loaded, s."""


def link_options(options: Mapping[str, object]) -> LinkOptions:
    """Read the options of a remote robot.

    Args:
        options: As in a user's robot file; missing keys have their defaults.

    Raises:
        InvalidSpec: If a key is unknown or a value not allowed.
    """
    try:
        link = LinkOptions.model_validate(options)
    except ValidationError as error:
        raise InvalidSpec(describe_problems(error, LinkOptions, "remote robot setting")) from None
    if (link.user is None) != (link.password_file is None):
        raise InvalidSpec("user and password_file of a remote robot belong together; give both")
    if link.tls is None and any(endpoint.startswith("tls/") for endpoint in link.connect):
        raise InvalidSpec("a tls endpoint needs certificates: give tls: {ca, certificate, key}")
    return link


def open_session(options: LinkOptions) -> zenoh.Session:
    """Connect to a robot's host.

    Args:
        options: Address of the robot, and credentials.

    Returns:
        A session with a link to the host.

    Raises:
        LinkLost: No host answers, or it refuses these credentials.
        InvalidSpec: A certificate or the password file cannot be read.
    """
    config = client_config(options)
    deadline = time.monotonic() + options.connect_timeout_s
    cause: zenoh.ZError | None = None
    # One at a time, because a Zenoh peer waits until every endpoint answers.
    for left, endpoint in zip(range(len(options.connect), 0, -1), options.connect, strict=True):
        share_s = max(deadline - time.monotonic(), 0.0) / left
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        config.insert_json5("connect/timeout_ms", str(max(1, round(1e3 * share_s))))
        try:
            session = zenoh.open(config)
        except zenoh.ZError as error:
            cause = error
            continue
        if session.info.links():  # Zenoh may open without a link, such as after a refusal
            return session
        session.close()
    raise LinkLost(_no_answer(options)) from cause


def client_config(options: LinkOptions) -> zenoh.Config:
    """Return the configuration of a client's session, with a link to the host only.

    Raises:
        InvalidSpec: A certificate or the password file cannot be read, or is invalid.
    """
    settings: dict[str, object] = {
        **POINT_TO_POINT,
        "listen/endpoints": [],
        "connect/endpoints": list(options.connect),
        "connect/timeout_ms": round(1e3 * options.connect_timeout_s),
        "connect/exit_on_failure": True,
        "connect/retry": {
            "period_init_ms": 100,
            "period_max_ms": 500,
            "period_increase_factor": 1.5,
        },
    }
    if options.tls is not None:
        check_certificates(options.tls)
        settings |= {
            "transport/link/tls/root_ca_certificate": str(options.tls.ca),
            "transport/link/tls/connect_certificate": str(options.tls.certificate),
            "transport/link/tls/connect_private_key": str(options.tls.key),
            "transport/link/tls/enable_mtls": True,
            "transport/link/tls/verify_name_on_connect": True,
        }
    if options.user is not None and options.password_file is not None:
        settings |= {
            "transport/auth/usrpwd/user": options.user,
            "transport/auth/usrpwd/password": _password(options.password_file),
        }
    return make_config(settings)


def make_config(settings: Mapping[str, object]) -> zenoh.Config:
    """Return a Zenoh configuration.

    Args:
        settings: Values by key.
    """
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


def warn_if_others_can_read(path: Path, kind: str) -> None:
    """Log a warning if other users of this machine have access to a file with a secret.

    Args:
        path: The file.
        kind: Kind of file, such as ``"password_file"``.
    """
    if path.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        log.warning("%s %s is accessible to other users; run: chmod 600 %s", kind, path, path)


def _no_answer(options: LinkOptions) -> str:
    where = ", ".join(options.connect)
    refused = (
        ", or it refuses these credentials"
        if options.tls is not None or options.user is not None
        else ", or it requires credentials, and none are given"
    )
    return (
        f"no host of robot {options.robot!r} answers at {where} within "
        f"{options.connect_timeout_s:g} s{refused}; start a host, for a simulated robot with: "
        "iher-robot serve --driver mujoco"
    )


def _password(path: Path) -> str:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise InvalidSpec(
            f"password_file {str(path)!r} cannot be read: {reason}; allowed: a text file with one "
            "line, the password"
        ) from None
    if len(lines) != 1 or not lines[0].strip():
        raise InvalidSpec(
            f"password_file {str(path)!r} has {len(lines)} lines, allowed: one, the password"
        )
    warn_if_others_can_read(path, "password_file")
    return lines[0].strip()  # so does the host with what its file of users says
