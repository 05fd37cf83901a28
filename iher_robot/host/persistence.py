"""State of a robot that survives restarts of its host: latched fault, tick counter, accounts."""

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
"""Ticks by which the stored ceiling of the tick counter is raised, 67 minutes at 25 Hz."""
_RESERVED_TICKS = 500
"""Ticks of an account that are reserved at once."""


class RobotMemory:
    """File with the latched fault, whether the robot needs a human, and a ceiling of its ticks."""

    def __init__(self, folder: Path) -> None:
        """Read the file.

        Args:
            folder: Created if it does not exist.

        Raises:
            UserError: The file is damaged.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self._lock = threading.Lock()  # stops come from another thread than the ticks
        self._path = folder / "robot.json"
        self._content: dict[str, Any] = {"ticks": 0, "fault": None, "human": False}
        if self._path.exists():
            self._content = _read(self._path)

    @property
    def fault(self) -> Fault | None:
        """The latched fault as last saved, None without one."""
        fault = self._content["fault"]
        return None if fault is None else Fault(fault["name"], fault["reason"], 0)

    @property
    def ticks(self) -> int:
        """Ceiling of the tick counter: no tick so far has a number above it."""
        return int(self._content["ticks"])

    @property
    def human_needed(self) -> bool:
        """Whether a reset needed a human, and none was done since."""
        return bool(self._content["human"])

    def save_human_needed(self, needed: bool) -> None:
        """Save whether a reset needed a human, and none was done since."""
        with self._lock:
            if needed != self._content["human"]:
                self._write(self._content | {"human": needed})

    def save_fault(self, latched: Callable[[], Fault | None]) -> None:
        """Save the latched fault, if it has changed.

        Args:
            latched: Returns it. Called under the lock, so that no older fault replaces a newer.
        """
        with self._lock:
            fault = latched()
            found = None if fault is None else {"name": fault.name, "reason": fault.reason}
            if found != self._content["fault"]:
                self._write(self._content | {"fault": found})

    def reserve_ticks(self, tick: int) -> None:
        """Raise the saved ceiling before the tick counter reaches it."""
        with self._lock:
            if tick + 1 >= self.ticks:
                self._write(self._content | {"ticks": tick + _TICKS_AHEAD})

    def _write(self, content: dict[str, Any]) -> None:
        data = dump_checked(content)
        write_atomically(self._path, lambda file: file.write(data))
        self._content = content


class RobotTotal(Closing):
    """The robot's own account of control ticks, over all clients and runs.

    Ticks are reserved in a ledger before they begin. A crash of the host counts the tick that was
    about to begin, a crash of the machine up to 500 ticks too many; neither counts too few.
    """

    def __init__(self, folder: Path, name: str) -> None:
        """Open the account.

        Args:
            folder: Folder of the robot's memory.
            name: Name of the robot.

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
        self._entries: dict[Account, Entry] = {}
        self._used: dict[Account, int] = {}
        self._stack = ExitStack()

    def reserve(self, account: Account) -> None:
        """Reserve ticks of an account, if none of those reserved before is left."""
        entry = self._entries.get(account)
        if entry is None or self._used[account] == entry.reserved_ticks:
            self._settle(account)
            entry = self._stack.enter_context(
                self._ledger.reserve(account, _RESERVED_TICKS, counted=True)
            )
            self._entries[account], self._used[account] = entry, 0

    def tick(self, account: Account) -> None:
        """Count a tick that is about to begin."""
        self.reserve(account)
        self._used[account] += 1
        self._entries[account].begin(self._used[account])
        self._spent[account] += 1

    @contextmanager
    def reserve_at_most(self, account: Account, ticks: int) -> Iterator[Entry]:
        """Reserve the most ticks that something may take. Settle the entry inside the block.

        Args:
            account: The account of the ticks.
            ticks: The most ticks.
        """
        try:
            with self._ledger.reserve(account, ticks) as entry:
                yield entry
        finally:
            open_ticks = self._entries[account].reserved_ticks if account in self._entries else 0
            used = self._used.get(account, 0)
            self._spent[account] = self._ledger.spent_ticks(account) - open_ticks + used

    def spent(self) -> dict[str, int]:
        """Return the ticks spent, by account."""
        return {str(account): ticks for account, ticks in self._spent.items()}

    def close(self) -> None:
        """Settle the reserved ticks, and release the file."""
        for account in list(self._entries):
            self._settle(account)
        self._stack.close()
        self._ledger.close()

    def _settle(self, account: Account) -> None:
        entry = self._entries.pop(account, None)
        if entry is not None:
            entry.settle(self._used[account])


def _read(path: Path) -> dict[str, Any]:
    try:
        return load_checked(read_file(path, "robot memory"), path, "robot memory")
    except UserError as error:
        raise UserError(
            f"{path} is damaged, which says whether the robot is stopped; check the robot, then "
            "restore the file or remove it"
        ) from error
