"""Errors for the user.

The command line prints a `UserError` as one sentence and exits with code 2.
"""

from __future__ import annotations

from collections.abc import Iterable


class UserError(ValueError):
    """Bad input. The message names the setting, its value, the allowed values and the remedy."""


def unknown_name(kind: str, name: str, allowed: Iterable[str]) -> UserError:
    """Build the error for an unknown name, with the most similar valid one.

    Args:
        kind: Kind of the name, such as ``"preset"``.
        name: The unknown name.
        allowed: Every valid name.

    Returns:
        The error, ready to raise.
    """
    from drivers.names import unknown

    return UserError(unknown(kind, name, allowed))


def describe(error: BaseException) -> str:
    """Describe an error on one line."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted"
    return " ".join(f"{type(error).__name__}: {error}".split())


class NoSolution(RuntimeError):
    """A controller finds no motion for an action; the robot holds for this tick."""
