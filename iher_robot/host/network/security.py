"""Authentication and roles of a served robot: the file of ``iher-robot serve --security``."""

from __future__ import annotations

from ipaddress import ip_address
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from drivers.errors import InvalidSpec
from drivers.names import unknown
from drivers.remote.certificates import TlsFiles, check_certificates
from drivers.remote.link import warn_if_others_can_read
from drivers.validation import describe_problems
from iher_robot.config.paths import TLS_PATHS, resolve_paths
from iher_robot.config.yaml import parse_mapping
from iher_robot.errors import UserError
from iher_robot.storage.files.atomic import read_file

_KIND = "security file"


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


class Roles(_Section):
    """Names of users, or common names of certificates, by role; a name may have several roles."""

    operator: tuple[str, ...] = ()
    """May do everything."""
    learner: tuple[str, ...] = ()
    """May move the robot, but not clear its faults."""
    viewer: tuple[str, ...] = ()
    """May watch, and stop."""
    perception: tuple[str, ...] = ()
    """May watch, stop, and publish object poses."""

    def names(self) -> dict[str, tuple[str, ...]]:
        """Return the names of each role, without the roles that have none."""
        return {role: names for role in Roles.model_fields if (names := getattr(self, role))}


class HostSecurity(_Section):
    """How clients authenticate, and the role of each."""

    tls: TlsFiles | None = None
    """Certificates for mutual TLS; a client's name is the common name of its certificate."""
    users: Path | None = None
    """File with a line ``user:password`` for each user."""
    roles: Roles = Field(default=Roles())
    """Names by role. A client without a role has no rights."""

    @model_validator(mode="after")
    def _validate_roles(self) -> HostSecurity:
        names = self.roles.names()
        if self.tls is None and self.users is None:
            raise ValueError("clients have no way to authenticate; give tls, users or both")
        if not names:
            raise ValueError(
                f"no client has a role; give names under roles.{' or roles.'.join(_ROLES)}"
            )
        for role, members in names.items():
            if not all(name.strip() for name in members):
                raise ValueError(f"roles.{role} has an empty name; remove it")
        return self


_ROLES = tuple(Roles.model_fields)
_PATHS = ("users", *TLS_PATHS)


def read_security(path: Path | None) -> HostSecurity | None:
    """Read a security file.

    Args:
        path: The file, with paths of other files relative to its own folder; None for none.

    Raises:
        UserError: It is missing, a key or value in it is not allowed, or a file that it names is
            missing or invalid.
    """
    if path is None:
        return None
    content = parse_mapping(read_file(path, _KIND), str(path))
    try:
        security = HostSecurity.model_validate(resolve_paths(content, path, _PATHS))
    except ValidationError as error:
        raise UserError(
            f"{path}: {describe_problems(error, HostSecurity, 'security setting')}"
        ) from None
    try:
        if security.tls is not None:
            check_certificates(security.tls)
    except InvalidSpec as error:
        raise UserError(f"{path}: {error}") from None
    if security.users is not None:
        _check_users(path, security)
    return security


def check_listening(listen: tuple[str, ...], security: HostSecurity | None, insecure: bool) -> None:
    """Check that no client can move the robot without authentication.

    Args:
        listen: Endpoints of the host.
        security: Authentication and roles; None for none.
        insecure: Whether the user accepted a host that every client on the network can command.

    Raises:
        UserError: An endpoint lacks the protection that it needs.
    """
    for endpoint in listen:
        if endpoint.startswith("tls/") and (security is None or security.tls is None):
            raise UserError(
                f"--listen is {endpoint!r} and no certificates are given; give tls in the file of "
                "--security, which iher-robot certs DIR makes"
            )
        if endpoint.startswith("tcp/") and security is not None and security.users is None:
            raise UserError(
                f"--listen is {endpoint!r}, where clients have no certificate; listen on "
                f"{endpoint.replace('tcp/', 'tls/', 1)}, or give users in the file of --security"
            )
        if security is None and not insecure and not _is_loopback(endpoint):
            raise UserError(
                f"--listen is {endpoint!r}, where any client on the network could move the robot; "
                "give --security FILE (see iher-robot certs), listen on 127.0.0.1, or accept it "
                "with --insecure"
            )


def _is_loopback(endpoint: str) -> bool:
    host = endpoint.split("/", 1)[1].rsplit(":", 1)[0].strip("[]")
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _check_users(path: Path, security: HostSecurity) -> None:
    assert security.users is not None
    users = _read_users(security.users)
    if security.tls is None:
        for role, names in security.roles.names().items():
            for name in names:
                if name not in users:
                    raise UserError(f"{path}: " + unknown(f"name in roles.{role}", name, users))


def _read_users(path: Path) -> list[str]:
    """Read the names in a file of users, parsed as Zenoh does."""
    try:
        lines = read_file(path, "file of users").decode().splitlines()
    except UnicodeDecodeError:
        raise UserError(f"file of users {path} is not UTF-8 text") from None
    users: list[str] = []
    for number, line in enumerate(lines, start=1):
        user, _, password = (part.strip() for part in line.partition(":"))
        if not line.strip():
            continue
        if not user or not password:
            raise UserError(f"file of users {path}, line {number}: allowed: user:password")
        if user in users:
            raise UserError(
                f"file of users {path}, line {number}: {user!r} appears twice; remove one"
            )
        users.append(user)
    if not users:
        raise UserError(f"file of users {path} is empty; give lines of user:password")
    warn_if_others_can_read(path, "file of users")
    return users
