"""SQLite files, which are checked when they are opened."""

from __future__ import annotations

import hashlib
import os
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgpack  # type: ignore[import-untyped]  # it ships neither types nor stubs

from drivers.closing import Closing
from iher_robot.errors import UserError
from iher_robot.storage.files.atomic import TEMPORARY_SUFFIX, sync_directory


@dataclass(frozen=True)
class Format:
    """Format of a kind of database.

    Attributes:
        kind: Name in messages, such as ``"ledger"``.
        application_id: SQLite's application id, four bytes in the file's header.
        version: Format version, from 1.
        schema: Statements that create it, in order.
    """

    kind: str
    application_id: int
    version: int
    schema: tuple[str, ...]


class Database(Closing):
    """SQLite file with a write-ahead log, whose pages and schema were checked.

    The check does not cover values: rows carry checksums for that.

    Args:
        path: The file; created if it does not exist, unless ``read_only``.
        form: The format it must have.
        read_only: Change nothing; another process may be writing.

    Raises:
        UserError: The file has another format or version, is damaged, or cannot be opened.
    """

    def __init__(self, path: Path, form: Format, *, read_only: bool = False) -> None:
        self.path = path
        self._form = form
        if not path.exists():
            if read_only:
                raise UserError(f"there is no {form.kind} at {path}")
            with self._explained("create"):
                _create(path, form)
        with self._explained("open"):
            self._connection = sqlite3.connect(
                f"{path.resolve().as_uri()}?{_mode(path, read_only)}",
                uri=True,
                timeout=5.0,  # a reader may hold it
                isolation_level=None,
            )
        # Damaged text is found by its checksum, not by a decoding error.
        self._connection.text_factory = lambda text: text.decode(errors="replace")
        try:
            with self._explained("open"):
                self._check(read_only)
        except BaseException:
            self._connection.close()
            raise

    def durable(self, durable: bool) -> None:
        """Set whether a commit waits for the disk.

        A commit that does not wait survives a crash of the process. It survives a crash of the
        machine only after a later commit that waited.
        """
        self.execute(f"PRAGMA synchronous = {'FULL' if durable else 'NORMAL'}")

    def execute(self, statement: str, values: Sequence[Any] = ()) -> sqlite3.Cursor:
        """Run one statement.

        Raises:
            UserError: The system refuses, such as on a full disk; nothing is written.
            sqlite3.IntegrityError: The statement violates a constraint.
        """
        with self._explained("write"):
            return self._connection.execute(statement, values)

    def rows(self, statement: str, values: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        """Return all rows of a query.

        Raises:
            UserError: The file cannot be read, or is damaged.
        """
        with self._explained("read"):
            return self._connection.execute(statement, values).fetchall()

    def each_row(self, statement: str) -> Iterator[tuple[Any, ...]]:
        """Iterate over the rows of a query, without holding all of them in memory.

        Raises:
            UserError: The file cannot be read, or is damaged.
        """
        with self._explained("read"):
            yield from self._connection.execute(statement)

    @contextmanager
    def snapshot(self) -> Iterator[None]:
        """Read everything in the block from one snapshot."""
        self.execute("BEGIN")
        try:
            yield
        finally:
            if self._connection.in_transaction:
                self._connection.execute("ROLLBACK")

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Commit everything in the block, or nothing."""
        try:
            self.execute("BEGIN IMMEDIATE")
            yield
            self.execute("COMMIT")
        except BaseException:
            if self._connection.in_transaction:  # some errors end it
                self._connection.execute("ROLLBACK")
            raise

    def close(self) -> None:
        """Release the file; closing twice does nothing."""
        self._connection.close()

    def _check(self, read_only: bool) -> None:
        execute = self._connection.execute
        execute("PRAGMA trusted_schema = OFF")
        execute("PRAGMA foreign_keys = ON")
        execute("PRAGMA synchronous = FULL")
        found = (_number(execute, "application_id"), _number(execute, "user_version"))
        if found[0] != self._form.application_id:
            raise UserError(f"{self.path} is no {self._form.kind} of iher-robot")
        if found[1] != self._form.version:
            raise UserError(
                f"{self.path} has {self._form.kind} format {found[1]}, this iher-robot reads "
                f"{self._form.version}; use the iher-robot that wrote it"
            )
        statements = {text for (text,) in execute("SELECT sql FROM sqlite_schema") if text}
        statements = {text for text in statements if not text.startswith("CREATE TABLE sqlite_")}
        (problem,) = execute("PRAGMA integrity_check(1)").fetchone()
        if statements != set(self._form.schema) or problem != "ok":
            raise sqlite3.DatabaseError(problem if problem != "ok" else "its schema is another")
        if not read_only:  # last: leave a foreign file unchanged
            execute("PRAGMA journal_mode = WAL")

    @contextmanager
    def _explained(self, doing: str) -> Iterator[None]:
        try:
            yield
        except sqlite3.IntegrityError:
            raise
        except OSError as error:
            raise UserError(f"cannot {doing} {self.path}: {error.strerror}") from error
        except (sqlite3.Error, UnicodeDecodeError) as error:  # the latter in SQLite's own messages
            primary = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT) & 0xFF
            if primary == sqlite3.SQLITE_FULL:
                raise UserError(f"cannot {doing} {self.path}: No space left on device") from error
            if primary in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR):
                kind = self._form.kind
                raise UserError(f"{self.path} is no {kind}, or damaged: {error}") from error
            raise UserError(f"cannot {doing} {self.path}: {error}") from error


def _create(path: Path, form: Format) -> None:
    """Create a database under a temporary name, so that an empty file is never a new one."""
    unfinished = path.with_name(f".{path.name}{TEMPORARY_SUFFIX}")
    unfinished.unlink(missing_ok=True)
    connection = sqlite3.connect(unfinished, isolation_level=None)
    try:
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("BEGIN IMMEDIATE")
        for statement in form.schema:
            connection.execute(statement)
        connection.execute(f"PRAGMA application_id = {form.application_id}")
        connection.execute(f"PRAGMA user_version = {form.version}")
        connection.execute("COMMIT")
    finally:
        connection.close()
    unfinished.replace(path)
    sync_directory(path.parent)


def _mode(path: Path, read_only: bool) -> str:
    if not read_only:
        return "mode=rw"
    logged = path.with_name(f"{path.name}-wal").exists()
    # Reading beside a writer needs a shared-memory file, for which permission may be missing.
    return "mode=ro" if logged or os.access(path.parent, os.W_OK) else "immutable=1"


def row_checksum(*values: object) -> bytes:
    """Checksum of the values of a row: integers, text, bytes and None."""
    return hashlib.blake2b(msgpack.packb(values), digest_size=16).digest()


def _number(execute: Callable[..., sqlite3.Cursor], pragma: str) -> int:
    (value,) = execute(f"PRAGMA {pragma}").fetchone()
    return int(value)
