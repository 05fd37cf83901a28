"""Zenoh configuration of a host: endpoints, and access control by role."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import zenoh

from drivers.remote.keys import REQUESTS, robot_key
from drivers.remote.link import POINT_TO_POINT, check_endpoint, make_config
from iher_robot.errors import UserError
from iher_robot.host.network.security import HostSecurity, check_listening

FOR_EVERYBODY = ("spec", "status", "ping", "stop")
FOR_OPERATORS = ("clear_fault",)
FOR_MOVERS = tuple(name for name in REQUESTS if name not in FOR_EVERYBODY + FOR_OPERATORS)

_GRANTS: Mapping[str, tuple[str, ...]] = {
    "operator": ("watch", "move", "clear", "perceive"),
    "learner": ("watch", "move"),
    "viewer": ("watch",),
    "perception": ("watch", "perceive"),
}
"""Groups of rules by role, named as in `_rules`."""

_EVERYBODY = "anybody"
"""Role of all clients of a host without security."""


def gateway_config(
    robot: str, listen: Sequence[str], security: HostSecurity | None, insecure: bool
) -> zenoh.Config:
    """Return the configuration of a host's Zenoh session.

    Args:
        robot: Name of the robot.
        listen: Zenoh endpoints to listen on.
        security: Authentication and roles. None for no authentication: then every client has the
            rights of an operator, but still cannot impersonate the host.
        insecure: Whether to accept that beyond this machine.

    Raises:
        UserError: An endpoint is malformed, or lacks the protection that it needs.
        InvalidSpec: The name is not allowed for a robot.
    """
    _check_endpoints(listen)
    check_listening(tuple(listen), security, insecure)
    settings: dict[str, object] = {
        **POINT_TO_POINT,
        "listen/endpoints": list(listen),
        "listen/exit_on_failure": True,
        "access_control": _access_control(robot, security),
    }
    if security is not None and security.tls is not None:
        settings |= {
            "transport/link/tls/root_ca_certificate": str(security.tls.ca),
            "transport/link/tls/listen_certificate": str(security.tls.certificate),
            "transport/link/tls/listen_private_key": str(security.tls.key),
            "transport/link/tls/enable_mtls": True,
        }
    if security is not None and security.users is not None:
        settings["transport/auth/usrpwd/dictionary_file"] = str(security.users)
    return make_config(settings)


def _check_endpoints(listen: Sequence[str]) -> None:
    if not listen:
        raise UserError("no endpoint to listen on; give --listen tcp/127.0.0.1:7447")
    for endpoint in listen:
        try:
            check_endpoint(endpoint)
        except ValueError as error:
            raise UserError(f"--listen: {error}") from None


def _access_control(robot: str, security: HostSecurity | None) -> dict[str, object]:
    subjects: list[dict[str, object]] = []
    policies: list[dict[str, object]] = []
    if security is None:
        members: Mapping[str, tuple[str, ...]] = {_EVERYBODY: ()}
    else:
        members = security.roles.names()
    for role, names in members.items():
        found = list(_subjects(role, names, security))
        rules = _GRANTS["operator" if role == _EVERYBODY else role]
        subjects += found
        policies.append({"rules": _ids(robot, rules), "subjects": [each["id"] for each in found]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for grant in _rules(robot).values() for rule in grant],
        "subjects": subjects,
        "policies": policies,
    }


def _subjects(
    role: str, names: tuple[str, ...], security: HostSecurity | None
) -> Iterable[dict[str, object]]:
    """Return Zenoh's subjects of a role: one for each way to log in, since one would need both."""
    if security is None:
        yield {"id": role}
        return
    if security.users is not None:
        yield {"id": f"{role} by user", "usernames": list(names)}
    if security.tls is not None:
        yield {"id": f"{role} by certificate", "cert_common_names": list(names)}


def _ids(robot: str, grants: Iterable[str]) -> list[object]:
    rules = _rules(robot)
    return [rule["id"] for grant in grants for rule in rules[grant]]


def _rules(robot: str) -> dict[str, list[dict[str, object]]]:
    """Return the rules of each grant. A message is ``ingress`` where the host receives it."""

    def keys(*names: str) -> list[str]:
        return [robot_key(robot, *name.split("/")) for name in names]

    def requests(names: Iterable[str]) -> list[str]:
        return keys(*(f"rpc/{name}" for name in names))

    alive, host = keys("alive/*"), keys("alive/host")
    return {
        "watch": [
            _rule("subscribe to states", "ingress", ["declare_subscriber"], keys("state", "fault")),
            _rule("receive states", "egress", ["put"], keys("state", "fault")),
            _rule("stop", "ingress", ["put"], keys("stop")),
            _rule("take stops", "egress", ["declare_subscriber"], keys("stop")),
            _rule("request", "ingress", ["query"], requests(FOR_EVERYBODY)),
            _rule("reply", "egress", ["declare_queryable", "reply"], keys("rpc/*")),
            _rule("announce", "ingress", ["liveliness_token"], alive),
            _rule("not as the host", "ingress", ["liveliness_token"], host, "deny"),
            _rule("host announces", "egress", ["liveliness_token"], host),
            _rule("watch liveliness", "ingress", _LIVELINESS, alive),
            _rule("host watches liveliness", "egress", _LIVELINESS, alive),
        ],
        "move": [
            _rule("command", "ingress", ["put"], keys("cmd")),
            _rule("take commands", "egress", ["declare_subscriber"], keys("cmd")),
            _rule("request motion", "ingress", ["query"], requests(FOR_MOVERS)),
        ],
        "clear": [_rule("clear faults", "ingress", ["query"], requests(FOR_OPERATORS))],
        "perceive": [
            _rule("publish poses", "ingress", ["put"], keys("object/*")),
            _rule("take poses", "egress", ["declare_subscriber"], keys("object/*")),
        ],
    }


_LIVELINESS = ["declare_liveliness_subscriber", "liveliness_query"]


def _rule(
    name: str, flow: str, messages: list[str], keys: list[str], permission: str = "allow"
) -> dict[str, object]:
    return {
        "id": name,
        "flows": [flow],
        "messages": messages,
        "key_exprs": keys,
        "permission": permission,
    }
