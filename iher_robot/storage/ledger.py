"""What a run has spent: control ticks by account, written down before they are used."""

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
    add_up,
    begun_ticks,
    lock_path,
)
from iher_robot.storage.files.lock import LockFile
from iher_robot.storage.files.sqlite import Database


class Entry:
    """A reservation; until it is settled it counts in full.

    Attributes:
        number: Its number in the ledger.
        reserved_ticks: Ticks that were written down.
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
        """Note how many have begun, the one about to begin included.

        From the first call on, a crash of this program leaves that number counted, and not the
        whole reservation; a crash of the machine still leaves the whole.

        Args:
            ticks: Ticks since the reservation.
        """
        self._begin(self.number, ticks)

    def settle(self, actual_ticks: int) -> None:
        """Replace the reservation by what was really used.

        Args:
            actual_ticks: Ticks used. More than were reserved is written down as it is: ticks
                that passed on a robot unseen are gone all the same.

        Raises:
            ValueError: Fewer than none, or settled already.
        """
        if actual_ticks < 0:
            raise ValueError(f"settled ticks must be >= 0, not {actual_ticks}")
        self._settle(self.number, actual_ticks)


class Ledger(Closing):
    """Append-only accounts of control ticks in one SQLite file; one process may hold it.

    A crash between reservation and settlement leaves counted what had begun by then, or the whole
    reservation: the ledger may over-count, never under-count.

    Example:
        >>> with ledger.reserve("motion", 50) as entry:
        ...     entry.settle(run_episode())

    Args:
        path: The file; created if it does not exist.

    Raises:
        FileHeld: Another process holds it.
        UserError: It is no ledger, is damaged, or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = LockFile(
            lock_path(path),
            f"ledger {path} is in use: another run works in this folder, wait for it to end or "
            "stop it",
        )
        # What an earlier holder noted stays noted until it is settled, whatever comes between.
        self._begun: dict[str, int] = dict(self._lock.note.get("begun", {}))
        try:
            self._database = Database(path, LEDGER)
        except BaseException:
            self._lock.close()
            raise
        try:
            self._accounts = add_up(self._database, self._lock.note.get("last", 0))
            self._settle_what_a_crash_left()
        except BaseException:
            self.close()
            raise

    @property
    def last_entry(self) -> int:
        """Number of the newest entry, 0 without one."""
        return self._accounts.last

    @property
    def open_reservations(self) -> dict[int, tuple[Account, int]]:
        """Account and ticks of what is reserved and not settled, by number."""
        self._take_new_entries()  # an interrupt may have come before the last one was taken
        return dict(self._accounts.open)

    @property
    def granted_ticks(self) -> int:
        """Ticks of motion that were granted beyond the run's own budget."""
        return self._accounts.granted_ticks

    @contextmanager
    def reserve(self, account: Account, ticks: int, *, counted: bool = False) -> Iterator[Entry]:
        """Write down ticks before they are used; settle inside the block.

        Args:
            account: What they are for.
            ticks: The most that will be used, at least one.
            counted: Whether ``Entry.begin`` is told before each of them: until it is, none counts
                after a crash of this program.

        Yields:
            The entry to settle. If it is not, by an exception or a crash, it counts in full, or
            as far as ``Entry.begin`` was told.
        """
        if account not in ACCOUNTS:
            raise ValueError(f"unknown account {account!r}, valid: {', '.join(ACCOUNTS)}")
        if ticks < 1:
            raise ValueError(f"reserved ticks must be >= 1, not {ticks}")
        self._take_new_entries()
        if counted:
            self._note_begun(self._accounts.last + 1, 0)  # first: its number is known
        else:
            self._begun.pop(str(self._accounts.last + 1), None)  # of one that was never written
        number = self._append("reserve", account, None, int(ticks))
        yield Entry(number, int(ticks), self._note_begun, self.settle)

    def settle(self, number: int, ticks: int) -> None:
        """Settle a reservation by its number.

        Raises:
            ValueError: It is settled already.
        """
        self._take_new_entries()  # an interrupt may have come before the last one was taken
        if number not in self._accounts.open:
            raise ValueError(f"entry {number} of the ledger is settled already")
        self._append("settle", self._accounts.open[number][0], number, int(ticks))

    def grant(self, ticks: int) -> None:
        """Write down more ticks of motion for the run.

        Args:
            ticks: At least one.
        """
        if ticks < 1:
            raise ValueError(f"granted ticks must be >= 1, not {ticks}")
        self._append("grant", "motion", None, int(ticks))

    def spent_ticks(self, account: Account) -> int:
        """Ticks of an account: those settled, and those reserved and not yet settled."""
        return self._accounts.spent[account]

    def close(self) -> None:
        """Release the file; closing twice does nothing."""
        self._database.close()
        self._lock.close()

    def _settle_what_a_crash_left(self) -> None:
        note = dict(self._lock.note)
        for number in list(self._accounts.open):
            begun = begun_ticks(note, number)
            if begun is not None:
                self.settle(number, begun)
        # Of a reservation that was noted and never written nothing may be left for its successor.
        self._begun = {}
        self._note()

    def _append(self, kind: Kind, account: Account, reservation: int | None, ticks: int) -> int:
        self._take_new_entries()  # an interrupt may have come before the last one was taken
        row = self._accounts.next_row(kind, account, reservation, ticks)
        self._database.execute("INSERT INTO entry VALUES (?, ?, ?, ?, ?, ?)", row)
        self._take_new_entries()
        self._begun.pop(str(reservation), None)
        self._note()
        return self._accounts.last

    def _take_new_entries(self) -> None:
        query = "SELECT * FROM entry WHERE id > ? ORDER BY id"
        rows = self._database.rows(query, (self._accounts.last,))
        if rows:
            accounts = self._accounts.copy()  # an interrupt finds all of it taken, or nothing
            for row in rows:
                accounts.take(row)
            self._accounts = accounts

    def _note_begun(self, number: int, ticks: int) -> None:
        self._begun[str(number)] = ticks
        self._note()

    def _note(self) -> None:
        self._lock.write(last=self._accounts.last, begun=self._begun)
