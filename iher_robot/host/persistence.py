"""What a robot remembers on its own side, whatever becomes of its host: faults, ticks, time."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from drivers.closing import Closing
from drivers.gate import Fault
from iher_robot.errors import UserError
from iher_robot.storage.accounts import ACCOUNTS, Account
from iher_robot.storage.files.atomic import read_file, write_atomically
from iher_robot.storage.files.checksum import dump_checked, load_checked
from iher_robot.storage.files.lock import FileHeld
from iher_robot.storage.ledger import Entry, Ledger

_TICKS_AHEAD = 100_000
"""Ticks of the counter that are written down at once, a good hour at 25 Hz."""
_RESERVED_TICKS = 500
"""Ticks of an account that are written down before they begin."""


class RobotMemory:
    """The latched fault, whether a human was asked for, and a ceiling of the ticks, in one file.

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
        self._content: dict[str, Any] = {"ticks": 0, "fault": None, "human": False}
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

    @property
    def human(self) -> bool:
        """Whether a human was asked for, and no reset was done since."""
        return bool(self._content["human"])

    def keep_human(self, asked_for: bool) -> None:
        """Write down whether a human was asked for, and no reset was done since."""
        with self._lock:
            if asked_for != self._content["human"]:
                self._write(self._content | {"human": asked_for})

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
        data = dump_checked(content)
        write_atomically(self._path, lambda file: file.write(data))
        self._content = content


class RobotTotal(Closing):
    """The robot's own account of control ticks, over all learners and runs.

    Ticks are written down before they begin. After a crash of the host it counts the one that was
    about to begin, after a crash of the machine up to 500 too many, and never too few.
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
        except FileHeld as error:
            raise UserError(
                f"robot {name!r} is served by another process already ({folder}); stop that one, "
                "or serve under another --name"
            ) from error
        self._spent = {account: self._ledger.spent_ticks(account) for account in ACCOUNTS}
        self._begun: dict[Account, Entry] = {}
        self._used: dict[Account, int] = {}
        self._stack = ExitStack()

    def begin(self, account: Account) -> None:
        """Write down ticks of an account that may begin now."""
        entry = self._begun.get(account)
        if entry is None or self._used[account] == entry.reserved_ticks:
            self._settle(account)
            entry = self._stack.enter_context(
                self._ledger.reserve(account, _RESERVED_TICKS, counted=True)
            )
            self._begun[account], self._used[account] = entry, 0

    def tick(self, account: Account) -> None:
        """Count a tick that is about to begin."""
        self.begin(account)
        self._used[account] += 1
        self._begun[account].begin(self._used[account])
        self._spent[account] += 1

    @contextmanager
    def longest(self, account: Account, ticks: int) -> Iterator[Entry]:
        """Write down the most ticks that something may take; settle inside the block.

        Args:
            account: What they are for.
            ticks: The most.
        """
        try:
            with self._ledger.reserve(account, ticks) as entry:
                yield entry
        finally:
            open_ticks = self._begun[account].reserved_ticks if account in self._begun else 0
            used = self._used.get(account, 0)
            self._spent[account] = self._ledger.spent_ticks(account) - open_ticks + used

    def spent(self) -> dict[str, int]:
        """Ticks by account."""
        return {str(account): ticks for account, ticks in self._spent.items()}

    def close(self) -> None:
        """Settle what was written down, and release the file."""
        for account in list(self._begun):
            self._settle(account)
        self._stack.close()
        self._ledger.close()

    def _settle(self, account: Account) -> None:
        entry = self._begun.pop(account, None)
        if entry is not None:
            entry.settle(self._used[account])


def _read(path: Path) -> dict[str, Any]:
    try:
        return load_checked(read_file(path, "robot memory"), path, "robot memory")
    except UserError as error:
        raise UserError(
            f"{path} is damaged: it says whether the robot is stopped; look at the robot, then "
            "put the file back or remove it"
        ) from error
