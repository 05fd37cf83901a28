"""Zenoh keys of a robot's host, and names of its requests; see ``docs/protocol.md``."""

from __future__ import annotations

import re

from drivers.errors import InvalidSpec

ROBOT_NAME = r"[a-z0-9][a-z0-9_-]{0,63}"

REQUESTS = (
    "spec",
    "status",
    "ping",
    "stop",
    "lease",
    "arm",
    "disarm",
    "reset",
    "hands_clear",
    "clear_fault",
)
"""Requests that a host answers, under ``rpc/``."""


def robot_key(robot: str, *parts: str) -> str:
    """Return a key of a robot, such as ``iher/v1/fetch/rpc/spec``.

    Args:
        robot: Name of the robot.
        parts: Parts of the key after the name.

    Raises:
        InvalidSpec: If the name is not allowed.
    """
    if not re.fullmatch(ROBOT_NAME, robot):
        raise InvalidSpec(
            f"robot name is {robot!r}, allowed: up to 64 lowercase letters, digits, - and _, "
            "starting with a letter or digit"
        )
    return "/".join(("iher/v1", robot, *parts))
