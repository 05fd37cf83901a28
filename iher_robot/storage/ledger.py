"""Ledger of control ticks by account, written before the ticks are used."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from drivers.closing import Closing
from iher_robot.storage.accounts import (
    ACCOUNTS,
    LEDGER,
    Account,
    Kind,
    begun_ticks,
    lock_path,
    total_entries,
)
from iher_robot.storage.files.lock import LockFile
from iher_robot.storage.files.sqlite import Database


class Entry:
    """A reservation, which counts in full until it is settled.

    Attributes:
        number: Number of the entry in the ledger.
        reserved_ticks: Reserved ticks.
    """

    def __init__(
        self,
        number: int,
        reserved_ticks: int,
        begin: Callable[[int, int], None],
        settle: Callable[[int, int], None],
    ) -> None:
        self.number = number
        self.reserved_ticks = reserved_ticks
        self._begin = begin
        self._settle = settle

    def begin(self, ticks: int) -> None:
        """Note how many ticks have begun, including the one about to begin.

        From the first call on, a crash of the process charges this number instead of the whole
        reservation. A crash of the machine still charges the whole reservation.

        Args:
            ticks: Ticks since the reservation.
        """
        self._begin(self.number, ticks)

    def settle(self, actual_ticks: int) -> None:
        """Replace the reservation by the ticks that were really used.

        Args:
            actual_ticks: Ticks used. May be more than reserved: a robot also spends ticks that
                this process does not see.

        Raises:
            ValueError: The number is negative, or the reservation is settled already.
        """
        if actual_ticks < 0:
            raise ValueError(f"settled ticks must be >= 0, not {actual_ticks}")
        self._settle(self.number, actual_ticks)


class Ledger(Closing):
    """Append-only accounts of control ticks in one SQLite file, for one process at a time.

    After a crash an open reservation counts as far as its ticks had begun, or in full: the ledger
    may over-count, but never under-counts.

    Example:
        >>> with ledger.reserve("motion", 50) as entry:
        ...     entry.settle(run_episode())

    Args:
        path: The file; created if it does not exist.

    Raises:
        FileHeld: Another process holds it.
        UserError: The file is no ledger, is damaged, or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = LockFile(
            lock_path(path),
            f"ledger {path} is in use by another run in this folder; wait for it to end or stop it",
        )
        # Notes of an earlier holder are kept until their reservations are settled.
        self._begun: dict[str, int] = dict(self._lock.note.get("begun", {}))
        try:
            self._database = Database(path, LEDGER)
        except BaseException:
            self._lock.close()
            raise
        try:
            self._accounts = total_entries(self._database, self._lock.note.get("last", 0))
            self._settle_after_crash()
        except BaseException:
            self.close()
            raise

    @property
    def last_entry(self) -> int:
        """Number of the newest entry, 0 if there is none."""
        return self._accounts.last

    @property
    def open_reservations(self) -> dict[int, tuple[Account, int]]:
        """Account and ticks of open reservations, by number."""
        self._read_new_entries()  # an interrupt may have skipped the last entry
        return dict(self._accounts.open)

    @property
    def granted_ticks(self) -> int:
        """Ticks of motion granted beyond the run's own budget."""
        return self._accounts.granted_ticks

    @contextmanager
    def reserve(self, account: Account, ticks: int, *, counted: bool = False) -> Iterator[Entry]:
        """Reserve ticks before they are used; settle inside the block.

        Args:
            account: Account to charge.
            ticks: The most that will be used, at least one.
            counted: Whether ``Entry.begin`` is called before each tick. After a crash of the
                process only the ticks that have begun count.

        Yields:
            The entry to settle. If an exception or a crash prevents that, it counts in full, or
            as far as ``Entry.begin`` noted.
        """
        if account not in ACCOUNTS:
            raise ValueError(f"unknown account {account!r}, valid: {', '.join(ACCOUNTS)}")
        if ticks < 1:
            raise ValueError(f"reserved ticks must be >= 1, not {ticks}")
        self._read_new_entries()
        if counted:
            self._note_begun(self._accounts.last + 1, 0)  # first: its number is already known
        else:
            self._begun.pop(
                str(self._accounts.last + 1), None
            )  # note of an entry that was never written
        number = self._append("reserve", account, None, int(ticks))
        yield Entry(number, int(ticks), self._note_begun, self.settle)

    def settle(self, number: int, ticks: int) -> None:
        """Settle a reservation by its number.

        Raises:
            ValueError: It is settled already.
        """
        self._read_new_entries()  # an interrupt may have skipped the last entry
        if number not in self._accounts.open:
            raise ValueError(f"entry {number} of the ledger is already settled")
        self._append("settle", self._accounts.open[number][0], number, int(ticks))

    def grant(self, ticks: int) -> None:
        """Grant the run more ticks of motion.

        Args:
            ticks: At least one.
        """
        if ticks < 1:
            raise ValueError(f"granted ticks must be >= 1, not {ticks}")
        self._append("grant", "motion", None, int(ticks))

    def spent_ticks(self, account: Account) -> int:
        """Ticks of an account, settled or reserved."""
        return self._accounts.spent[account]

    def close(self) -> None:
        """Release the file; closing twice does nothing."""
        self._database.close()
        self._lock.close()

    def _settle_after_crash(self) -> None:
        note = dict(self._lock.note)
        for number in list(self._accounts.open):
            begun = begun_ticks(note, number)
            if begun is not None:
                self.settle(number, begun)
        # A note whose reservation was never written must not count for the next reservation.
        self._begun = {}
        self._write_note()

    def _append(self, kind: Kind, account: Account, reservation: int | None, ticks: int) -> int:
        self._read_new_entries()  # an interrupt may have skipped the last entry
        row = self._accounts.next_row(kind, account, reservation, ticks)
        self._database.execute("INSERT INTO entry VALUES (?, ?, ?, ?, ?, ?)", row)
        self._read_new_entries()
        self._begun.pop(str(reservation), None)
        self._write_note()
        return self._accounts.last

    def _read_new_entries(self) -> None:
        query = "SELECT * FROM entry WHERE id > ? ORDER BY id"
        rows = self._database.rows(query, (self._accounts.last,))
        if rows:
            accounts = self._accounts.copy()  # an interrupt leaves all of it applied, or nothing
            for row in rows:
                accounts.apply(row)
            self._accounts = accounts

    def _note_begun(self, number: int, ticks: int) -> None:
        self._begun[str(number)] = ticks
        self._write_note()

    def _write_note(self) -> None:
        self._lock.write(last=self._accounts.last, begun=self._begun)
