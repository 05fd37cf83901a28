"""Messages about names that do not exist."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def unknown(kind: str, name: str, allowed: Iterable[str]) -> str:
    """Say that a name does not exist, and which do.

    Args:
        kind: What the name stands for, such as ``"driver"``.
        name: The name as given.
        allowed: Every valid name.

    Returns:
        One sentence, with the nearest valid name where one is near.
    """
    names = sorted(allowed)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"unknown {kind} {name!r}, valid: {', '.join(names)}{hint}"
