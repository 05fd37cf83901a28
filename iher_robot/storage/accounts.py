"""Format of a ledger and its totals by account."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

from iher_robot.errors import UserError
from iher_robot.storage.files.lock import read_note
from iher_robot.storage.files.sqlite import Database, Format, row_checksum

Account = Literal["motion", "reset", "idle", "evaluation", "deployment"]
ACCOUNTS: tuple[Account, ...] = get_args(Account)

Kind = Literal["reserve", "settle", "grant"]

LEDGER = Format(
    kind="ledger",
    application_id=0x69686572,  # "iher" in ASCII
    version=2,
    schema=(
        """CREATE TABLE entry (
            id INTEGER PRIMARY KEY AUTOINCREMENT,
            kind TEXT NOT NULL CHECK (kind IN ('reserve', 'settle', 'grant')),
            account TEXT NOT NULL,
            reservation INTEGER UNIQUE REFERENCES entry (id),
            ticks INTEGER NOT NULL CHECK (ticks >= 0),
            seal BLOB NOT NULL
        )""",
        *(
            f"CREATE TRIGGER entry_{change} BEFORE {change} ON entry "
            "BEGIN SELECT RAISE(ABORT, 'the ledger is append-only'); END"
            for change in ("UPDATE", "DELETE")
        ),
    ),
)


def lock_path(ledger: Path) -> Path:
    """Lock file of a ledger."""
    return ledger.with_suffix(".lock")


@dataclass
class Accounts:
    """Totals of a ledger.

    The checksum of an entry covers the checksum before it, so that no entry can be changed, left
    out or moved unnoticed.

    Attributes:
        spent: Ticks by account, settled or reserved.
        open: Account and ticks of open reservations, by number.
        granted_ticks: Ticks of motion granted beyond the run's own budget.
        last: Number of the newest entry.
        checksum: Checksum of that entry.
    """

    spent: dict[Account, int] = field(default_factory=lambda: dict.fromkeys(ACCOUNTS, 0))
    open: dict[int, tuple[Account, int]] = field(default_factory=dict)
    granted_ticks: int = 0
    last: int = 0
    checksum: bytes = b""

    def copy(self) -> Accounts:
        """An independent copy."""
        return replace(self, spent=dict(self.spent), open=dict(self.open))

    def next_row(
        self, kind: Kind, account: Account, reservation: int | None, ticks: int
    ) -> tuple[Any, ...]:
        """Row of the next entry."""
        content = (self.last + 1, kind, account, reservation, ticks)
        return (*content, row_checksum(self.checksum, *content))

    def apply(self, row: tuple[Any, ...]) -> None:
        """Add an entry to the totals.

        Raises:
            ValueError: It is not the next entry, or has changed since it was written.
        """
        number, kind, account, reservation, ticks, checksum = row
        if number != self.last + 1 or checksum != row_checksum(self.checksum, *row[:-1]):
            raise ValueError(f"entry {number} has changed since it was written")
        if kind == "reserve":
            self.spent[account] += ticks
            self.open[number] = (account, ticks)
        elif kind == "settle":
            self.spent[account] += ticks - self.open.pop(reservation)[1]
        else:
            self.granted_ticks += ticks
        self.last, self.checksum = number, checksum


def total_entries(database: Database, newest: int = 0) -> Accounts:
    """Read and check every entry of a ledger.

    Args:
        database: The ledger.
        newest: Number of an entry that was certainly written.

    Raises:
        UserError: An entry is damaged or missing.
    """
    accounts = Accounts()
    try:
        for row in database.each_row("SELECT * FROM entry ORDER BY id"):
            accounts.apply(row)
    except (ValueError, LookupError, TypeError) as error:
        raise UserError(f"{database.path} is damaged: {error}") from error
    for (written,) in database.rows("SELECT seq FROM sqlite_sequence"):
        newest = max(newest, written)
    if accounts.last < newest:
        raise UserError(
            f"{database.path} lost its entries from {accounts.last + 1} to {newest}: it or its "
            "-wal file is damaged or too old; restore the newest ones"
        )
    return accounts


def read_accounts(path: Path) -> Accounts:
    """Read the totals of a ledger, even while a run writes it.

    An open reservation counts as far as the run has noted that its ticks have begun, else in full.

    Raises:
        UserError: There is no ledger, or it is damaged.
    """
    note = read_note(lock_path(path))  # first: the ledger may grow meanwhile
    with Database(path, LEDGER, read_only=True) as database, database.snapshot():
        accounts = total_entries(database, note.get("last", 0))
    for number, (account, ticks) in accounts.open.items():
        begun = begun_ticks(read_note(lock_path(path)), number)
        if begun is not None:
            accounts.spent[account] += begun - ticks
    return accounts


def begun_ticks(note: Any, reservation: int) -> int | None:
    """Ticks of a reservation that have begun, from the note in the lock file; None if unknown."""
    begun = note.get("begun", {}).get(str(reservation))
    return None if begun is None else int(begun)
