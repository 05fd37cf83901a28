"""Errors that a user can act on.

The command line prints them as one sentence and exits with code 2.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class UserError(ValueError):
    """Bad input: the message says what, its value, what is allowed and what to do."""


def unknown_name(kind: str, name: str, allowed: Iterable[str]) -> UserError:
    """Build the error for a name that does not exist, with the nearest one that does.

    Args:
        kind: What the name stands for, such as ``"task"``.
        name: The name as given.
        allowed: Every valid name.

    Returns:
        The error, ready to raise.
    """
    names = sorted(allowed)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return UserError(f"unknown {kind} {name!r}, valid: {', '.join(names)}{hint}")
