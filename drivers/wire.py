"""Messages between a robot's host and its clients: MessagePack, checked on arrival.

``docs/protocol.md`` describes them for hosts in other languages. Nothing here is ever executed:
a message holds maps, lists, text, numbers and arrays, the latter as ``[dtype, shape, bytes]``.
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
"""No message is longer; a longer one is not read at all."""

_DTYPE = "<f8"
_MAX_DIMENSIONS = 1
_MAX_LENGTH = 4096

Model = TypeVar("Model", bound="Message")


class WireError(ValueError):
    """A message that is not of this protocol.

    Attributes:
        reason: One word, under which it is counted.
    """

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


def pack_array(array: NDArray[np.float64]) -> list[Any]:
    """Return an array as it travels: dtype, shape and little-endian bytes."""
    return [_DTYPE, list(array.shape), np.ascontiguousarray(array, dtype=_DTYPE).tobytes()]


def _read_array(value: object) -> NDArray[np.float64]:
    if isinstance(value, np.ndarray):
        return value
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError("no array of the form [dtype, shape, bytes]")
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
        raise ValueError(f"an array of shape {shape} has {8 * count} bytes")
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
        message: Arrays in it become ``[dtype, shape, bytes]``.

    Returns:
        Its bytes.
    """
    content = message.model_dump() if isinstance(message, Message) else message
    packed: bytes = msgpack.packb(content, default=_pack_other)
    return packed


def unpack(model: type[Model], data: bytes) -> Model:
    """Decode and check a message.

    Args:
        model: What it must be.
        data: Its bytes.

    Raises:
        WireError: It is too long, no MessagePack, of another version, or not this message.
    """
    return check(model, unpack_map(data))


def unpack_map(data: bytes) -> dict[str, Any]:
    """Decode a message without checking what is in it, but for its version.

    Args:
        data: Its bytes.

    Raises:
        WireError: It is too long, no MessagePack, no map, or of another version.
    """
    if len(data) > MAX_BYTES:
        raise WireError("too_long", f"message of {len(data)} bytes, allowed: {MAX_BYTES}")
    try:
        content = msgpack.unpackb(data, strict_map_key=True, use_list=True)
    except Exception as error:  # noqa: BLE001 - msgpack raises half a dozen unrelated types
        raise WireError("malformed", f"no MessagePack: {error}") from None
    if not isinstance(content, dict):
        raise WireError("malformed", f"message is {type(content).__name__}, allowed: a map")
    if content.get("v") != VERSION or type(content.get("v")) is not int:
        found = reprlib.repr(content.get("v"))  # bounded in depth, which repr is not
        raise WireError("version", f"version is {found:.20}, allowed: {VERSION}")
    return content


def check(model: type[Model], content: Mapping[str, object]) -> Model:
    """Check a decoded message.

    Args:
        model: What it must be.
        content: What `unpack_map` returned.

    Raises:
        WireError: It is not this message.
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
    raise TypeError(f"{type(value).__name__} has no place in a message")
