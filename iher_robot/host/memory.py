"""What a robot remembers on its own side, whatever becomes of its host: faults, ticks, time."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from drivers.closing import Closing
from drivers.gate import Fault
from iher_robot.durable_file import read_file, write_atomically
from iher_robot.errors import UserError
from iher_robot.ledger import ACCOUNTS, Account, Entry, Ledger, LedgerInUse

_TICKS_AHEAD = 100_000
"""Ticks of the counter that are written down at once, a good hour at 25 Hz."""
_RESERVED_TICKS = 50
"""Ticks of motion that are written down before they begin."""


class RobotMemory:
    """The latched fault and a ceiling of the tick counter, in one file.

    Raises:
        UserError: The file is damaged.
    """

    def __init__(self, folder: Path) -> None:
        """Read what a robot remembers.

        Args:
            folder: Made if it does not exist.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self._lock = threading.Lock()  # a stop comes in another thread than the ticks
        self._path = folder / "robot.json"
        self._content: dict[str, Any] = {"ticks": 0, "fault": None}
        if self._path.exists():
            self._content = _read(self._path)

    @property
    def fault(self) -> Fault | None:
        """The fault that was latched when it was last written."""
        fault = self._content["fault"]
        return None if fault is None else Fault(fault["name"], fault["reason"], 0)

    @property
    def ticks(self) -> int:
        """No tick counted so far is above it."""
        return int(self._content["ticks"])

    def keep(self, latched: Callable[[], Fault | None]) -> None:
        """Write down the latched fault, if it is another one than before.

        Args:
            latched: Returns it. Asked under the lock: an older answer must not replace a newer.
        """
        with self._lock:
            fault = latched()
            found = None if fault is None else {"name": fault.name, "reason": fault.reason}
            if found != self._content["fault"]:
                self._write(self._content | {"fault": found})

    def count(self, tick: int) -> None:
        """Write down a new ceiling before the counter reaches the old one."""
        with self._lock:
            if tick + 1 >= self.ticks:
                self._write(self._content | {"ticks": tick + _TICKS_AHEAD})

    def _write(self, content: dict[str, Any]) -> None:
        data = json.dumps(content).encode()
        write_atomically(self._path, lambda file: file.write(data))
        self._content = content


class RobotTotal(Closing):
    """The robot's own account of control ticks, over all learners and runs.

    Ticks are written down before they begin; after a crash it counts too much, never too little.
    """

    def __init__(self, folder: Path, name: str) -> None:
        """Open the account.

        Args:
            folder: Of the robot's memory.
            name: Of the robot.

        Raises:
            UserError: Another host serves this robot, or the file is damaged.
        """
        try:
            self._ledger = Ledger(folder / "total.sqlite")
        except LedgerInUse as error:
            raise UserError(
                f"robot {name!r} is served by another process already ({folder}); stop that one, "
                "or serve under another --name"
            ) from error
        self._spent = {account: self._ledger.spent_ticks(account) for account in ACCOUNTS}
        self._stack = ExitStack()
        self._entry: Entry | None = None
        self._used = 0

    def begin(self) -> None:
        """Write down ticks of motion that may begin now."""
        if self._entry is None:
            self._reserve()

    def tick(self) -> None:
        """Count a tick of motion that is about to begin."""
        if self._entry is None or self._used == _RESERVED_TICKS:
            self.end()
            self._reserve()
        self._used += 1
        self._spent["motion"] += 1

    def end(self) -> None:
        """Settle what was written down and not used."""
        if self._entry is not None:
            self._entry.settle(self._used)
            self._stack.close()
        self._entry, self._used = None, 0

    def add(self, account: Account, ticks: int) -> None:
        """Count ticks of another account."""
        if ticks > 0:
            with self._ledger.reserve(account, ticks) as entry:
                entry.settle(ticks)
            self._spent[account] += ticks

    def spent(self) -> dict[str, int]:
        """Ticks by account."""
        return {str(account): ticks for account, ticks in self._spent.items()}

    def close(self) -> None:
        """Settle what was written down, and release the file."""
        self.end()
        self._ledger.close()

    def _reserve(self) -> None:
        self._entry = self._stack.enter_context(self._ledger.reserve("motion", _RESERVED_TICKS))


def _read(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(read_file(path, "robot memory"))
        fault = content["fault"]
        whole = isinstance(content["ticks"], int) and (
            fault is None or (isinstance(fault["name"], str) and isinstance(fault["reason"], str))
        )
    except (ValueError, KeyError, TypeError):
        whole = False
    if not whole:
        raise UserError(
            f"{path} is damaged: it says whether the robot is stopped; look at the robot, then "
            "put the file back or remove it"
        )
    return dict(content)
