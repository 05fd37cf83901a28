"""Names of what a robot's host publishes, listens to and answers; see ``docs/protocol.md``."""

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
"""What a host answers under ``rpc/``."""


def robot_key(robot: str, *parts: str) -> str:
    """Return a key of a robot, such as ``iher/v1/fetch/rpc/spec``.

    Args:
        robot: Name of the robot.
        parts: What comes after it.

    Raises:
        InvalidSpec: If it is no name of a robot.
    """
    if not re.fullmatch(ROBOT_NAME, robot):
        raise InvalidSpec(
            f"robot name is {robot!r}, allowed: up to 64 small letters, digits, - and _, the "
            "first no sign"
        )
    return "/".join(("iher/v1", robot, *parts))
