"""Errors that a user can act on.

The command line prints them as one sentence and exits with code 2.
"""

from __future__ import annotations

from collections.abc import Iterable


class UserError(ValueError):
    """Bad input: the message says what, its value, what is allowed and what to do."""


def unknown_name(kind: str, name: str, allowed: Iterable[str]) -> UserError:
    """Build the error for a name that does not exist, with the nearest one that does.

    Args:
        kind: What the name stands for, such as ``"preset"``.
        name: The name as given.
        allowed: Every valid name.

    Returns:
        The error, ready to raise.
    """
    from drivers.names import unknown

    return UserError(unknown(kind, name, allowed))


def describe(error: BaseException) -> str:
    """What ended something, in one line."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted"
    return " ".join(f"{type(error).__name__}: {error}".split())


class NoSolution(RuntimeError):
    """A controller knows no motion for an action; the robot holds for this tick."""
