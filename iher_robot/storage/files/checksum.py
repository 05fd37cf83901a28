"""JSON objects that carry a digest of themselves: any JSON reader reads them, and damage shows."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from iher_robot.errors import UserError

SEAL = "sha256"


def seal(content: Mapping[str, Any]) -> dict[str, Any]:
    """Add the digest of an object, under the name ``sha256``.

    Args:
        content: Plain values; numbers are finite.
    """
    return dict(content) | {SEAL: _digest(content)}


def seal_line(content: Mapping[str, Any]) -> bytes:
    """Write a sealed object on one line, without its end.

    Args:
        content: Plain values; numbers are finite.
    """
    return json.dumps(seal(content), allow_nan=False).encode()


def open_line(text: bytes, path: Path | str, kind: str) -> dict[str, Any]:
    """Read a sealed object and check it, whatever its line breaks.

    Args:
        text: The object.
        path: Where it is from, for the message.
        kind: What the file should be.

    Returns:
        The content, without the digest.

    Raises:
        UserError: It is none, or a value differs from what was sealed.
    """
    try:
        content = json.loads(text)
        digest = content.pop(SEAL)
        whole = bool(digest == _digest(content))
    except (ValueError, RecursionError, AttributeError, LookupError, TypeError):
        whole = False
    if not whole:
        raise UserError(f"{path} is no {kind} of iher-robot, or it is truncated or damaged")
    return dict(content)


def _digest(content: Mapping[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
