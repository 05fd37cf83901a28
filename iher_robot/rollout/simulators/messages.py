"""Messages between a run and its child processes: dicts as torch files, never executed."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Iterable, Mapping
from multiprocessing.connection import Connection
from typing import Any

import torch

from iher_robot.learning.episode import Episode

Message = dict[str, Any]

GONE = (EOFError, ConnectionError)
"""Errors that mean that the other side has closed the connection."""

_ARRAYS = tuple(field.name for field in dataclasses.fields(Episode))


def send_message(connection: Connection, message: Mapping[str, Any]) -> None:
    """Send a message; waits until the other side has room for it.

    Args:
        connection: Connection to the other side.
        message: Dicts, lists, text, numbers, tensors.

    Raises:
        OSError: The other side has closed it.
    """
    connection.send_bytes(pack_message(message))


def receive_message(connection: Connection) -> Message:
    """Wait for the next message; its tensors are on the CPU.

    Raises:
        EOFError: The other side has closed it.
        OSError: It closed it in the middle of a message.
    """
    return unpack_message(connection.recv_bytes())


def pack_message(message: Mapping[str, Any]) -> memoryview:
    """Serialize a message of dicts, lists, text, numbers and tensors."""
    buffer = io.BytesIO()
    torch.save(dict(message), buffer)
    return buffer.getbuffer()


def unpack_message(content: bytes | memoryview) -> Message:
    """Deserialize the result of ``pack_message``; its tensors are on the CPU."""
    message: Message = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    return message


def pack_episodes(episodes: Iterable[Episode]) -> list[dict[str, torch.Tensor]]:
    """Serialize episodes, in their own precision."""
    return [
        {name: torch.as_tensor(getattr(episode, name)) for name in _ARRAYS} for episode in episodes
    ]


def unpack_episodes(packed: Iterable[Mapping[str, torch.Tensor]]) -> list[Episode]:
    """Deserialize the result of ``pack_episodes``."""
    return [Episode(**{name: one[name].numpy() for name in _ARRAYS}) for one in packed]
