"""Checksums inside JSON objects and ZIP archives, which stay readable by any other reader."""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from iher_robot.errors import UserError

_KEY = "sha256"

_DIGEST_CHARS = 64
_NO_COMMENT = b"\0\0"
_COMMENT_LENGTH = struct.pack("<H", _DIGEST_CHARS)


def add_checksum(content: Mapping[str, Any]) -> dict[str, Any]:
    """Add the digest of a JSON object under the key ``sha256``.

    Args:
        content: Plain values; numbers are finite.
    """
    return dict(content) | {_KEY: _digest(content)}


def dump_checked(content: Mapping[str, Any]) -> bytes:
    """Encode a JSON object with its checksum on one line, without a line break.

    Args:
        content: Plain values; numbers are finite.
    """
    return json.dumps(add_checksum(content), allow_nan=False).encode()


def load_checked(text: bytes, path: Path | str, kind: str) -> dict[str, Any]:
    """Decode a JSON object and check its checksum; line breaks do not matter.

    Args:
        text: The object.
        path: Origin, for the message.
        kind: Kind of the file, for the message.

    Returns:
        The content without the checksum.

    Raises:
        UserError: It is not such an object, or a value has changed.
    """
    try:
        content = json.loads(text)
        digest = content.pop(_KEY)
        whole = bool(digest == _digest(content))
    except (ValueError, RecursionError, AttributeError, LookupError, TypeError):
        whole = False
    if not whole:
        raise UserError(f"{path} is no {kind} of iher-robot, or it is truncated or damaged")
    return dict(content)


def add_zip_checksum(archive: bytes) -> bytes:
    """Store the SHA-256 of a ZIP archive in its comment.

    ``np.savez`` and ``torch.save`` write ZIP archives, whose own CRCs cover the members, but not
    names, sizes or the directory. Their loaders ignore the comment.

    Args:
        archive: A ZIP archive without a comment.

    Returns:
        The archive with the digest of all bytes before the comment.
    """
    if not archive.endswith(_NO_COMMENT):
        raise ValueError("only a ZIP archive without a comment takes a checksum")
    body = archive[: -len(_NO_COMMENT)] + _COMMENT_LENGTH
    return body + hashlib.sha256(body).hexdigest().encode()


def check_zip(archive: bytes, path: Path, kind: str) -> None:
    """Check the checksum of a ZIP archive, before any parser sees it.

    Args:
        archive: Content of the file.
        path: The file, for the message.
        kind: Kind of the file, for the message.

    Raises:
        UserError: A byte has changed, or there is no checksum.
    """
    body, digest = archive[:-_DIGEST_CHARS], archive[-_DIGEST_CHARS:]
    if hashlib.sha256(body).hexdigest().encode() != digest:
        raise UserError(f"{path} is no {kind} of iher-robot, or it is truncated or damaged")


def _digest(content: Mapping[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
