"""Messages that a host must refuse, each with the reason under which it must count it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import msgpack  # type: ignore[import-untyped]
import numpy as np

from drivers.wire import pack

ANY = "any"
"""Reason of a message with a random bit flipped, which depends on the bit."""
MOST_BYTES = 8192
N_JOINTS, N_FINGERS = 8, 2
_NO_COUNTS: tuple[object, ...] = (-1, 2**63, 2**64 - 1, 0.5, float("nan"), "0", None, True, [0])
_FAR_OFF = (0, 1, 10**6, 2**40, 2**63 - 1)
_WRONG_VERSIONS: tuple[object, ...] = (0, 2, -1, 2**40, "1", 1.0, True, None, {}, [1])
_HUGE_HEADERS = tuple(
    bytes([code]) + b"\xff" * size for code, size in ((0xDD, 4), (0xDF, 4), (0xC6, 4), (0xDB, 4))
)
REQUESTS = ("spec", "ping", "lease", "arm", "disarm", "reset", "hands_clear", "clear_fault", "stop")


class Hostile(NamedTuple):
    """A message: the part of its key after the robot's name, its bytes, and why it is refused."""

    key: str
    body: bytes
    reason: str


class HostileMessages:
    """Draws messages for a host whose boot id and lease are known, as they are to every viewer.

    The host must refuse all of them: those that are valid and have the lease are repetitions.
    """

    def __init__(self, rng: np.random.Generator, boot: str, token: int) -> None:
        self._rng = rng
        self._boot = boot
        self._token = token
        self._commands: tuple[Callable[[], tuple[bytes, str]], ...] = (
            self._random_bytes,
            self._random_content,
            self._wrong_version,
            self._wrong_boot,
            self._wrong_token,
            self._wrong_n,
            self._wrong_answers,
            self._wrong_array,
            self._wrong_values,
            self._wrong_fields,
            self._wrong_kind,
            self._truncated,
            self._flipped,
            self._nested,
            self._too_long,
        )

    def commands(self, count: int) -> Iterator[Hostile]:
        for kind in self._rng.integers(len(self._commands), size=count):
            yield Hostile("cmd", *self._commands[kind]())

    def poses(self, count: int) -> Iterator[Hostile]:
        """Poses of objects that are not objects of perception at this host."""
        for _ in range(count):
            body, reason = self._any_of(self._random_bytes, self._random_content, self._pose)
            yield Hostile("object/object0", body, f"object_{reason}")

    def stops(self, count: int) -> Iterator[Hostile]:
        """Invalid stops; none of them stops the robot."""
        for _ in range(count):
            body, reason = self._any_of(self._random_bytes, self._random_content, self._stop)
            yield Hostile("stop", body, f"request_{reason}")

    def requests(self, count: int) -> Iterator[Hostile]:
        for _ in range(count):
            name = str(self._rng.choice(REQUESTS))
            make = self._stop if name == "stop" else self._request(name)
            body, reason = self._any_of(self._random_bytes, self._random_content, make)
            yield Hostile(f"rpc/{name}", body, f"request_{reason}")

    def _command(self, **changes: object) -> dict[str, Any]:
        joints, fingers = np.zeros(N_JOINTS), np.zeros(N_FINGERS)
        content = {"v": 1, "boot": self._boot, "token": self._token, "n": 0, "answers": 0}
        motion = {"q_target": joints, "dq": joints, "duration_s": 0.04, "finger_target": fingers}
        return content | {"kind": "joint"} | motion | changes

    def _random_bytes(self) -> tuple[bytes, str]:
        body = self._rng.bytes(int(self._rng.integers(200)))
        try:
            is_map = isinstance(msgpack.unpackb(body, strict_map_key=True), dict)
        except Exception:  # noqa: BLE001 - msgpack raises half a dozen unrelated types
            is_map = False
        return body, "version" if is_map else "malformed"

    def _random_content(self) -> tuple[bytes, str]:
        content = self._value(3)
        return msgpack.packb(content), "version" if isinstance(content, dict) else "malformed"

    def _value(self, depth: int) -> Any:
        kind = self._rng.integers(8 if depth else 6)
        if kind >= 6:
            inner = [self._value(depth - 1) for _ in range(self._rng.integers(4))]
            return inner if kind == 6 else {f"key {i}": value for i, value in enumerate(inner)}
        return (
            None,
            bool(self._rng.integers(2)),
            int(self._rng.integers(-(2**62), 2**62)),
            float(self._rng.standard_normal()),
            "text" * int(self._rng.integers(9)),
            self._rng.bytes(int(self._rng.integers(40))),
        )[kind]

    def _wrong_version(self) -> tuple[bytes, str]:
        return pack(self._command(v=self._one(_WRONG_VERSIONS))), "version"

    def _wrong_boot(self) -> tuple[bytes, str]:
        if self._rng.random() < 0.5:
            return pack(self._command(boot=self._rng.bytes(8).hex())), "wrong_boot"
        return pack(self._command(boot=self._one((None, 7, "b" * 201, b"boot")))), "malformed"

    def _wrong_token(self) -> tuple[bytes, str]:
        if self._rng.random() < 0.5:
            token = self._one((0, self._token + 1, 2**63 - 1, self._token + 10**6))
            return pack(self._command(token=token)), "wrong_token"
        return pack(self._command(token=self._one(_NO_COUNTS))), "malformed"

    def _wrong_n(self) -> tuple[bytes, str]:
        if self._rng.random() < 0.5:
            return pack(self._command()), "repeated"
        return pack(self._command(n=self._one(_NO_COUNTS))), "malformed"

    def _wrong_answers(self) -> tuple[bytes, str]:
        if self._rng.random() < 0.5:
            return pack(self._command(answers=self._one(_FAR_OFF))), "repeated"
        return pack(self._command(answers=self._one(_NO_COUNTS))), "malformed"

    def _wrong_array(self) -> tuple[bytes, str]:
        array = self._one(
            (
                [0.0] * N_JOINTS,
                ["<f4", [N_JOINTS], bytes(4 * N_JOINTS)],
                ["|O", [N_JOINTS], bytes(8 * N_JOINTS)],
                ["<f8", [N_JOINTS, 1], bytes(8 * N_JOINTS)],
                ["<f8", [-N_JOINTS], bytes(8 * N_JOINTS)],
                ["<f8", [2**40], bytes(8)],
                ["<f8", [N_JOINTS], bytes(8 * N_JOINTS - 1)],
                ["<f8", N_JOINTS, bytes(8 * N_JOINTS)],
                None,
                {},
            )
        )
        return pack(self._command(**{self._one(("q_target", "dq")): array})), "malformed"

    def _wrong_values(self) -> tuple[bytes, str]:
        size = int(self._one((0, 1, N_JOINTS - 1, N_JOINTS, 300)))
        value = float(self._one((np.nan, np.inf, -np.inf, 1e300, -1e300, 0.0)))
        changes = {self._one(("q_target", "dq", "finger_target")): np.full(size, value)}
        return pack(self._command(**changes, duration_s=value)), "repeated"

    def _wrong_fields(self) -> tuple[bytes, str]:
        content = self._command()
        if self._rng.random() < 0.5:
            del content[self._one(("boot", "token", "n", "answers", "q_target", "duration_s"))]
        else:
            content[self._one(("extra", "__class__", ""))] = self._value(2)
        return pack(content), "malformed"

    def _wrong_kind(self) -> tuple[bytes, str]:
        kind = self._one(("teleport", "", 7, None, ["joint"], "hold", "ee_delta", "JOINT"))
        return pack(self._command(kind=kind)), "malformed"

    def _truncated(self) -> tuple[bytes, str]:
        body = pack(self._command())
        return body[: int(self._rng.integers(len(body)))], "malformed"

    def _flipped(self) -> tuple[bytes, str]:
        body = bytearray(pack(self._command(boot="not this one")))
        body[self._rng.integers(len(body))] ^= 1 << int(self._rng.integers(8))
        return bytes(body), ANY

    def _nested(self) -> tuple[bytes, str]:
        depth = int(self._rng.integers(2, 2000))
        if self._rng.random() < 0.5:
            return b"\x91" * depth + b"\xc0", "malformed"
        if self._rng.random() < 0.3:
            # MessagePack can decode this depth; the error message must not fail on it.
            return b"\x81\xa1v" + b"\x91" * min(depth, 1015) + b"\xc0", "version"
        head = pack(self._command())[1:]
        return b"\x8b" + head + b"\xa1x" + b"\x81\xa1x" * depth + b"\xc0", "malformed"

    def _too_long(self) -> tuple[bytes, str]:
        if self._rng.random() < 0.5:
            return self._one(_HUGE_HEADERS) + self._rng.bytes(8), "malformed"
        size = int(self._rng.integers(MOST_BYTES // 8, 4096))
        return pack(self._command(q_target=np.zeros(size))), "too_long"

    def _pose(self) -> tuple[bytes, str]:
        zero = np.zeros(3)
        pose = {"pos": zero, "quat": np.zeros(4), "linvel": zero, "angvel": zero}
        content = pose | {"v": 1, "n": 1, "age_s": 0.0, "frame": "world"}
        if self._rng.random() < 0.5:
            return pack(content), "invalid"
        name = self._one(tuple(pose | {"n": 0, "age_s": 0}))
        return pack(content | {name: self._one((None, "x", -1, [1]))}), "malformed"

    def _stop(self) -> tuple[bytes, str]:
        content: dict[str, object] = {"v": 1, "fault": "hostile", "reason": "none"}
        if self._rng.random() < 0.3:
            return pack(
                content | {"fault": self._one(("", "no\x00name\x1b[2J", "A b"))}
            ), "malformed"
        name = self._one(("fault", "reason"))
        return pack(content | {name: self._one((None, 7, "x" * 5000, ["x"]))}), "malformed"

    def _request(self, name: str) -> Callable[[], tuple[bytes, str]]:
        stale: dict[str, object] = {"boot": self._boot, "token": self._token + 1}
        requests: dict[str, dict[str, object]] = {
            "spec": {"scene": "no such scene"},
            "lease": {"op": "acquire", "session": "a stranger", "holder": "x"},
            "arm": stale,
            "disarm": stale,
            "reset": stale | {"objects": {}, "seed": 0},
            "hands_clear": stale | {"boot": "another"},
            "clear_fault": {"name": "hostile"},
        }
        content = requests.get(name, {})

        def make() -> tuple[bytes, str]:
            if content and self._rng.random() < 0.5:
                return pack({"v": 1} | content), "refused"
            changes = {"extra": self._value(2)} if not content else {self._one(tuple(content)): 7.5}
            return pack({"v": 1} | content | changes), "malformed"

        return make

    def _any_of(self, *makers: Callable[[], tuple[bytes, str]]) -> tuple[bytes, str]:
        return makers[self._rng.integers(len(makers))]()

    def _one(self, choices: tuple[Any, ...]) -> Any:
        return choices[self._rng.integers(len(choices))]
