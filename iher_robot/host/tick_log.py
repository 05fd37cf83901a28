"""Log of a host's control ticks: one line of JSON for each."""

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

_MAX_WAITING_LINES = 1500
_CLOSING_S = 2.0


class TickLog(Closing):
    """Appends a line for each tick to a file, without ever blocking the control loop.

    A separate thread writes. Each line goes to the operating system at once, without a sync: it
    survives a crash of the host, but not a power cut. While the disk is full, fails or is too slow,
    ticks are left out and counted. A line that was cut off does not damage the next one.

    Attributes:
        lost: Ticks that were left out.
    """

    def __init__(self, path: Path) -> None:
        """Open the file for appending.

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
        self._count_lock = threading.Lock()
        self._lines: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._write, daemon=True, name="tick log")
        self._thread.start()

    def add(self, state: RobotState, info: HostInfo, now_ns: int) -> None:
        """Log a tick that has ended. Never blocks.

        Args:
            state: State of the robot at its end.
            info: Published with that state.
            now_ns: Time of publication, on the host's monotonic clock.
        """
        if self._lines.qsize() >= _MAX_WAITING_LINES:
            self._leave_out("the disk is too slow")
            return
        self._lines.put(
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
        """Write the lines that wait, for at most 2 s, and close the file."""
        self._lines.put(None)
        self._thread.join(_CLOSING_S)
        if not self._thread.is_alive():
            self._file.close()

    def _write(self) -> None:
        while (entry := self._lines.get()) is not None:
            line = json.dumps(entry, separators=(",", ":")).encode() + b"\n"
            if self._cut_off:
                line = b"\n" + line
            try:
                written = self._file.write(line)
            except OSError as error:
                self._leave_out(error.strerror or str(error))
                continue
            self._cut_off = written != len(line)
            if self._cut_off:
                self._leave_out("no space for a whole line")

    def _leave_out(self, reason: str) -> None:
        with self._count_lock:
            self.lost += 1
            first = self.lost == 1
        if first:
            log.warning(
                "tick log %s leaves out ticks: %s; the robot keeps running", self._path, reason
            )


def _applied(state: RobotState) -> dict[str, Any] | None:
    """Return the command applied in the tick that ended with a state, None if none was."""
    applied = state.applied
    if applied is None or applied.tick != state.seq:
        return None
    return {
        "answers": applied.command.answers,
        "kind": applied.command.kind,
        "clipped": list(applied.clipped),
    }
