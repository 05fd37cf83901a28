"""What a run has spent: control ticks by account, written down before they are used."""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Literal, get_args

from drivers.closing import Closing
from iher_robot.errors import UserError

Account = Literal["motion", "reset", "idle", "evaluation", "deployment"]
ACCOUNTS: tuple[Account, ...] = get_args(Account)

# "iher" in ASCII: tells a ledger from any other SQLite file.
_APPLICATION_ID = 0x69686572
_FORMAT = 1
_SCHEMA = (
    """CREATE TABLE reservation (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        account TEXT NOT NULL,
        ticks INTEGER NOT NULL CHECK (ticks > 0)
    )""",
    """CREATE TABLE settlement (
        id INTEGER PRIMARY KEY REFERENCES reservation (id),
        ticks INTEGER NOT NULL CHECK (ticks >= 0)
    )""",
    *(
        f"CREATE TRIGGER {table}_{change} BEFORE {change} ON {table} "
        "BEGIN SELECT RAISE(ABORT, 'the ledger is append-only'); END"
        for table in ("reservation", "settlement")
        for change in ("UPDATE", "DELETE")
    ),
)


class BudgetError(Exception):
    """More ticks were asked for than the budget still has."""


class Entry:
    """A reservation; until it is settled it counts in full."""

    def __init__(self, reserved_ticks: int, record: Callable[[int], None]) -> None:
        self.reserved_ticks = reserved_ticks
        self._record = record

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
        self._record(actual_ticks)


class LedgerInUse(UserError):
    """Another process holds a ledger."""


class Ledger(Closing):
    """Append-only accounts of control ticks in one SQLite file; one process may hold it.

    A crash between reservation and settlement leaves the reservation counted: the ledger may
    over-count, never under-count.

    Example:
        >>> with ledger.reserve("motion", 50) as entry:
        ...     entry.settle(run_episode())

    Args:
        path: The file; created if it does not exist.

    Raises:
        LedgerInUse: Another process holds it.
        UserError: It is no ledger, or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._connection = sqlite3.connect(path, timeout=0, isolation_level=None)
        except sqlite3.Error as error:
            raise UserError(f"cannot open ledger {path}: {error}") from error
        try:
            self._open()
        except sqlite3.Error as error:
            self._connection.close()
            if error.sqlite_errorcode in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
                raise LedgerInUse(
                    f"ledger {path} is in use: another run works in this folder, wait for it to "
                    "end or stop it"
                ) from error
            raise UserError(f"{path} is no ledger, or damaged: {error}") from error
        except UserError:
            self._connection.close()
            raise

    def _open(self) -> None:
        execute = self._connection.execute
        # Before the first access: then the write-ahead log needs no shared memory, and the lock
        # stays until the process closes the file or dies.
        execute("PRAGMA locking_mode = EXCLUSIVE")
        execute("PRAGMA journal_mode = WAL")
        execute("PRAGMA synchronous = FULL")
        execute("PRAGMA foreign_keys = ON")
        execute("BEGIN EXCLUSIVE")
        (identity,) = execute("PRAGMA application_id").fetchone()
        (version,) = execute("PRAGMA user_version").fetchone()
        (tables,) = execute("SELECT COUNT(*) FROM sqlite_master").fetchone()
        if tables == 0 and identity == 0:
            for statement in _SCHEMA:
                execute(statement)
            execute(f"PRAGMA application_id = {_APPLICATION_ID}")
            execute(f"PRAGMA user_version = {_FORMAT}")
        elif (identity, version) != (_APPLICATION_ID, _FORMAT):
            raise UserError(f"{self.path} is no ledger of iher-robot, or of another version")
        execute("COMMIT")

    @contextmanager
    def reserve(self, account: Account, ticks: int) -> Iterator[Entry]:
        """Write down ticks before they are used; settle inside the block.

        Args:
            account: What they are for.
            ticks: The most that will be used, at least one.

        Yields:
            The entry to settle. If it is not, by an exception or a crash, it counts in full.
        """
        if account not in ACCOUNTS:
            raise ValueError(f"unknown account {account!r}, valid: {', '.join(ACCOUNTS)}")
        if ticks < 1:
            raise ValueError(f"reserved ticks must be >= 1, not {ticks}")
        cursor = self._connection.execute(
            "INSERT INTO reservation (account, ticks) VALUES (?, ?)", (account, int(ticks))
        )
        yield Entry(int(ticks), partial(self._settle, cursor.lastrowid))

    def _settle(self, number: int | None, ticks: int) -> None:
        try:
            self._connection.execute("INSERT INTO settlement VALUES (?, ?)", (number, int(ticks)))
        except sqlite3.IntegrityError:
            raise ValueError(f"entry {number} of the ledger is settled already") from None

    def spent_ticks(self, account: Account) -> int:
        """Ticks of an account: those settled, and those reserved and not yet settled."""
        (ticks,) = self._connection.execute(
            "SELECT COALESCE(SUM(COALESCE(settlement.ticks, reservation.ticks)), 0) "
            "FROM reservation LEFT JOIN settlement USING (id) WHERE account = ?",
            (account,),
        ).fetchone()
        return int(ticks)

    def close(self) -> None:
        """Release the file; closing twice does nothing."""
        self._connection.close()


class Budget:
    """Control ticks of motion that a run may spend, over all its interruptions.

    Args:
        ledger: Holds what was spent.
        budget_ticks: Ticks that the account ``motion`` may reach, see ``budget_ticks``.
    """

    def __init__(self, ledger: Ledger, budget_ticks: int) -> None:
        self.ledger = ledger
        self.budget_ticks = budget_ticks

    @property
    def spent_ticks(self) -> int:
        """Ticks of motion so far, reservations included."""
        return self.ledger.spent_ticks("motion")

    @property
    def remaining_ticks(self) -> int:
        """Ticks that may still be reserved, never negative."""
        return max(0, self.budget_ticks - self.spent_ticks)

    @contextmanager
    def reserve(self, ticks: int) -> Iterator[Entry]:
        """Reserve ticks of motion, see ``Ledger.reserve``.

        Raises:
            BudgetError: Fewer remain; nothing is reserved.
        """
        remaining = self.remaining_ticks
        if ticks > remaining:
            raise BudgetError(f"{ticks} ticks asked for, {remaining} remain in the budget")
        with self.ledger.reserve("motion", ticks) as entry:
            yield entry


def budget_ticks(minutes: float, control_period: float) -> int:
    """Whole control ticks in a number of robot minutes.

    Args:
        minutes: Robot minutes, taken as the decimal number that Python prints, so that 0.1 is a
            tenth.
        control_period: Seconds a tick, to the nanosecond.

    Returns:
        Ticks, rounded down: 40 minutes at 0.04 s are 60000.

    Raises:
        UserError: The minutes are not finite, or do not hold a single tick.
    """
    period = Fraction(round(control_period * 10**9), 10**9)
    if not math.isfinite(minutes) or minutes <= 0:
        raise UserError(f"budget is {minutes} minutes, allowed: a finite number above 0")
    ticks = math.floor(Fraction(repr(float(minutes))) * 60 / period)
    if ticks < 1:
        raise UserError(
            f"budget is {minutes} minutes, allowed: at least one control tick, "
            f"{float(period / 60):g} minutes"
        )
    return ticks
