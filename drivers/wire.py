"""Encoding of messages between a robot's host and its clients: MessagePack, checked on receipt.

``docs/protocol.md`` describes the messages for hosts in other languages. A message contains only
maps, lists, text, numbers and arrays as ``[dtype, shape, bytes]``; nothing in it is executed.
"""

from __future__ import annotations

import reprlib
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

import msgpack  # type: ignore[import-untyped]  # it ships neither types nor stubs
import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
)

from drivers.validation import describe_first_problem

VERSION = 1
MAX_BYTES = 1 << 20
"""Greatest length of a message; a longer one is refused unread."""

_DTYPE = "<f8"
_MAX_DIMENSIONS = 1
_MAX_LENGTH = 4096

Model = TypeVar("Model", bound="Message")


class WireError(ValueError):
    """A message that does not conform to the protocol.

    Attributes:
        reason: One word under which refusals are counted.
    """

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


def pack_array(array: NDArray[np.float64]) -> list[Any]:
    """Encode an array as dtype, shape and little-endian bytes."""
    return [_DTYPE, list(array.shape), np.ascontiguousarray(array, dtype=_DTYPE).tobytes()]


def _read_array(value: object) -> NDArray[np.float64]:
    if isinstance(value, np.ndarray):
        return value
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError("array is malformed, allowed: [dtype, shape, bytes]")
    dtype, shape, data = value
    if dtype != _DTYPE:
        raise ValueError(f"dtype is {reprlib.repr(dtype):.20}, allowed: {_DTYPE!r}")
    if not isinstance(shape, list) or len(shape) > _MAX_DIMENSIONS:
        raise ValueError(
            f"shape is {reprlib.repr(shape):.40}, allowed: at most {_MAX_DIMENSIONS} dimension"
        )
    if not all(type(size) is int and 0 <= size <= _MAX_LENGTH for size in shape):
        raise ValueError(
            f"shape is {reprlib.repr(shape):.40}, allowed: sizes from 0 to {_MAX_LENGTH}"
        )
    count = int(np.prod(shape, dtype=np.int64))
    if not isinstance(data, bytes) or len(data) != 8 * count:
        raise ValueError(f"data do not fit shape {shape}, allowed: {8 * count} bytes")
    return np.frombuffer(data, dtype=_DTYPE).reshape(shape).astype(np.float64)


Array: TypeAlias = Annotated[NDArray[np.float64], BeforeValidator(_read_array)]
Name: TypeAlias = Annotated[str, Field(max_length=200)]
Text: TypeAlias = Annotated[str, Field(max_length=4000)]
Count: TypeAlias = Annotated[int, Field(ge=0, lt=2**63)]


class Part(BaseModel):
    """A map inside a message."""

    model_config = ConfigDict(
        strict=True,
        frozen=True,
        extra="forbid",
        arbitrary_types_allowed=True,
        use_attribute_docstrings=True,
    )


class Message(Part):
    """A whole message."""

    v: Literal[1] = 1
    """Version of the protocol."""


def pack(message: Message | Mapping[str, object]) -> bytes:
    """Encode a message.

    Args:
        message: Its arrays become ``[dtype, shape, bytes]``.
    """
    content = message.model_dump() if isinstance(message, Message) else message
    packed: bytes = msgpack.packb(content, default=_pack_other)
    return packed


def unpack(model: type[Model], data: bytes) -> Model:
    """Decode and check a message.

    Args:
        model: Type of the message.
        data: The encoded message.

    Raises:
        WireError: It is too long, not MessagePack, of another version, or not of this type.
    """
    return check(model, unpack_map(data))


def unpack_map(data: bytes) -> dict[str, Any]:
    """Decode a message, checking only its version.

    Args:
        data: The encoded message.

    Raises:
        WireError: It is too long, not MessagePack, not a map, or of another version.
    """
    if len(data) > MAX_BYTES:
        raise WireError("too_long", f"message of {len(data)} bytes, allowed: {MAX_BYTES}")
    try:
        content = msgpack.unpackb(data, strict_map_key=True, use_list=True)
    except Exception as error:  # noqa: BLE001 - msgpack raises half a dozen unrelated types
        raise WireError("malformed", f"message is not MessagePack: {error}") from None
    if not isinstance(content, dict):
        raise WireError("malformed", f"message is {type(content).__name__}, allowed: a map")
    if content.get("v") != VERSION or type(content.get("v")) is not int:
        found = reprlib.repr(content.get("v"))  # bounded in depth, which repr is not
        raise WireError("version", f"version is {found:.20}, allowed: {VERSION}")
    return content


def check(model: type[Model], content: Mapping[str, object]) -> Model:
    """Check a decoded message.

    Args:
        model: Type of the message.
        content: Returned by `unpack_map`.

    Raises:
        WireError: It is not of this type.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        problem = describe_first_problem(error)
    except RecursionError:
        problem = "nested too deeply"
    raise WireError("malformed", f"no {model.__name__}: {problem}")


def _pack_other(value: object) -> object:
    if isinstance(value, np.ndarray):
        return pack_array(value)
    raise TypeError(
        f"{type(value).__name__} cannot be encoded; use scalars, text, lists, maps and arrays"
    )
