"""What is said of a robot that a fault stops."""

from __future__ import annotations


def latched_sentence(robot: str, fault: str, reason: str) -> str:
    """Say what stopped a robot and how it is cleared.

    Args:
        robot: Name of the robot.
        fault: Name of the latched fault.
        reason: What happened, in words.
    """
    return (
        f"{robot} is stopped by {fault!r} ({reason}); once it is safe, clear it with: iher-robot "
        f"clear-fault {fault}"
    )
