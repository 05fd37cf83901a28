"""A black box on the robot's side: one line of JSON for each control tick."""

from __future__ import annotations

import json
import logging
import os
import queue
import threading
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from drivers.closing import Closing
from drivers.remote.state_message import HostInfo
from drivers.state import RobotState
from iher_robot.errors import UserError

log = logging.getLogger(__name__)

_WAITING_LINES = 1500
_CLOSING_S = 2.0


class TickLog(Closing):
    """Appends what the robot did in each tick to a file, and never keeps the robot waiting.

    A thread of its own writes. Each line goes to the operating system at once, without a sync: it
    outlives the host, and not a power cut. While the disk is full, fails or is too slow, ticks are
    left out and counted. A line that was cut off is followed by a whole one.

    Attributes:
        lost: Ticks that were left out.
    """

    def __init__(self, path: Path) -> None:
        """Open the file, to go on at its end.

        Args:
            path: The file; created if it does not exist.

        Raises:
            UserError: It cannot be written.
        """
        self.lost = 0
        self._path = path
        try:
            self._file = path.open("a+b", buffering=0)
            end = self._file.seek(0, os.SEEK_END)
            self._cut_off = end > 0 and os.pread(self._file.fileno(), 1, end - 1) != b"\n"
        except OSError as error:
            raise UserError(
                f"cannot write tick log {path}: {error.strerror or error}; choose another file "
                "with --tick-log"
            ) from error
        self._counting = threading.Lock()
        self._waiting: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._write, daemon=True, name="tick log")
        self._thread.start()

    def add(self, state: RobotState, info: HostInfo, now_ns: int) -> None:
        """Log a tick that has ended. This never waits.

        Args:
            state: What the robot reported then.
            info: What the host said with it.
            now_ns: When that was, on the host's monotonic clock.
        """
        if self._waiting.qsize() >= _WAITING_LINES:
            self._lose("the disk is too slow")
            return
        self._waiting.put(
            {
                "boot": info.boot,
                "seq": state.seq,
                "stamp_ns": state.stamp_ns,
                "host_ns": now_ns,
                "utc": datetime.now(UTC).isoformat(timespec="milliseconds"),
                "token": info.token,
                "n": info.n,
                "armed": info.armed,
                "mode": str(state.mode),
                "fault": state.fault,
                "applied": _applied(state),
            }
        )

    def close(self) -> None:
        """Write what waits, unless the disk takes longer than the end of a host may."""
        self._waiting.put(None)
        self._thread.join(_CLOSING_S)
        if not self._thread.is_alive():
            self._file.close()

    def _write(self) -> None:
        while (entry := self._waiting.get()) is not None:
            line = json.dumps(entry, separators=(",", ":")).encode() + b"\n"
            if self._cut_off:
                line = b"\n" + line
            try:
                written = self._file.write(line)
            except OSError as error:
                self._lose(error.strerror or str(error))
                continue
            self._cut_off = written != len(line)
            if self._cut_off:
                self._lose("no space for a whole line")

    def _lose(self, reason: str) -> None:
        with self._counting:
            self.lost += 1
            first = self.lost == 1
        if first:
            log.warning(
                "tick log %s leaves out ticks: %s; the robot goes on without it", self._path, reason
            )


def _applied(state: RobotState) -> dict[str, Any] | None:
    """Say which command was in force in the tick that ended with a state; None for none."""
    applied = state.applied
    if applied is None or applied.tick != state.seq:
        return None
    return {
        "answers": applied.command.answers,
        "kind": applied.command.kind,
        "clipped": list(applied.clipped),
    }
