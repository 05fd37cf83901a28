"""Error message for an unknown name."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def unknown(kind: str, name: str, allowed: Iterable[str]) -> str:
    """Return the message for an unknown name, with the valid names.

    Args:
        kind: Kind of the name, such as ``"driver"``.
        name: The name as given.
        allowed: Every valid name.

    Returns:
        One sentence, with the closest valid name if one is similar.
    """
    names = sorted(allowed)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"unknown {kind} {name!r}, valid: {', '.join(names)}{hint}"
