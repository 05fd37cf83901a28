"""The ledger adds up, even after crashes, and the budget is never exceeded."""

from __future__ import annotations

import contextlib
import itertools
import os
import sqlite3
import subprocess
import sys
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from iher_robot.errors import UserError
from iher_robot.storage.accounts import ACCOUNTS, LEDGER, Account, lock_path, read_accounts
from iher_robot.storage.budget import Budget, BudgetError
from iher_robot.storage.files.checksum import dump_checked
from iher_robot.storage.ledger import Ledger
from iher_robot.storage.robot_time import RobotTime


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "ledger.sqlite"


OPERATIONS = st.lists(
    st.tuples(st.sampled_from(ACCOUNTS), st.integers(1, 500), st.none() | st.floats(0, 1)),
    max_size=12,
)


@settings(deadline=None, max_examples=25)
@given(operations=OPERATIONS)
def test_spent_is_what_was_settled_plus_open_reservations(
    tmp_path_factory: pytest.TempPathFactory, operations: list[tuple[Account, int, float | None]]
) -> None:
    path = tmp_path_factory.mktemp("ledger") / "ledger.sqlite"
    expected = dict.fromkeys(ACCOUNTS, 0)
    with Ledger(path) as ledger:
        for account, ticks, share in operations:
            with ledger.reserve(account, ticks) as entry:
                assert ledger.spent_ticks(account) == expected[account] + ticks
                if share is None:
                    expected[account] += ticks
                else:
                    entry.settle(int(share * ticks))
                    expected[account] += int(share * ticks)
            assert ledger.spent_ticks(account) == expected[account]
    with Ledger(path) as reopened:
        assert {account: reopened.spent_ticks(account) for account in ACCOUNTS} == expected


CRASH = """
import os, sys
from pathlib import Path
from iher_robot.storage.ledger import Ledger
ledger = Ledger(Path(sys.argv[1]))
with ledger.reserve("motion", 50) as entry:
    entry.settle(48)
with ledger.reserve("motion", 50):
    os._exit(9)
"""


CRASH_AT_7 = CRASH.replace(
    'with ledger.reserve("motion", 50):',
    'with ledger.reserve("motion", 50) as entry:\n    entry.begin(7)',
)


def test_a_crash_inside_a_reservation_leaves_it_counted(path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", CRASH, str(path)], check=False)
    assert done.returncode == 9
    with Ledger(path) as ledger:
        assert ledger.spent_ticks("motion") == 98


def test_a_crash_leaves_what_had_begun_counted(path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", CRASH_AT_7, str(path)], check=False)
    assert done.returncode == 9
    before = read_accounts(path)
    assert before.spent["motion"] == 55
    with Ledger(path) as ledger:
        assert ledger.spent_ticks("motion") == 55
        assert not ledger.open_reservations, "it is settled"


@pytest.mark.parametrize("note", [b"", b"junk", b"another start of the machine"])
def test_a_crash_without_a_note_of_this_boot_leaves_all_counted(path: Path, note: bytes) -> None:
    subprocess.run([sys.executable, "-c", CRASH_AT_7, str(path)], check=False)
    lock_path(path).write_bytes(note or dump_checked({"boot": "x", "begun": {"3": 7}}))
    assert read_accounts(path).spent["motion"] == 98
    with Ledger(path) as ledger:
        assert ledger.spent_ticks("motion") == 98
        assert ledger.open_reservations == {3: ("motion", 50)}


def test_a_ledger_can_be_read_while_a_run_writes_it(path: Path) -> None:
    with Ledger(path) as ledger, ledger.reserve("motion", 50) as entry:
        entry.begin(3)
        assert read_accounts(path).spent["motion"] == 3
        assert ledger.spent_ticks("motion") == 50
    with pytest.raises(UserError, match="there is no ledger at"):
        read_accounts(path.with_name("absent.sqlite"))


class Interruption(KeyboardInterrupt):
    pass


def test_an_interrupt_at_any_line_leaves_begun_ticks_counted(path: Path) -> None:
    """Interrupt between any two lines: earlier ticks are counted, and the ledger still works."""
    begun = lines = 0

    def trace(frame: FrameType, event: str, _: object) -> Any:
        nonlocal lines
        if "iher_robot" not in frame.f_code.co_filename:
            return None
        if event == "line":
            lines += 1
            if lines == stop_at:
                sys.settrace(None)
                raise Interruption
        return trace

    for stop_at in itertools.count(1):
        lines = begun = 0
        path.unlink(missing_ok=True)
        lock_path(path).unlink(missing_ok=True)
        with Ledger(path) as ledger:
            sys.settrace(trace)
            try:
                with ledger.reserve("motion", 50, counted=True) as entry:
                    try:
                        begun = 1
                        entry.begin(1)
                    finally:
                        entry.settle(begun)
            except Interruption:
                with contextlib.suppress(Interruption), ledger.reserve("reset", 5) as another:
                    another.settle(5)
            else:
                break
            finally:
                sys.settrace(None)
        with Ledger(path) as again:
            assert again.spent_ticks("motion") in {begun, 1}, stop_at
            assert again.spent_ticks("reset") == 5
    assert stop_at > 50


def test_an_empty_file_is_a_damaged_ledger_not_a_new_one(path: Path) -> None:
    Ledger(path).close()
    path.write_bytes(b"")
    with pytest.raises(UserError, match=r"ledger\.sqlite is no ledger"):
        Ledger(path)


def test_an_interrupted_recovery_loses_nothing(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ledger = Ledger(path)
    for account, ticks in (("motion", 3), ("idle", 7)):
        with ledger.reserve(account, 500, counted=True) as entry:  # type: ignore[arg-type]
            entry.begin(ticks)
    ledger._database.close()
    ledger._lock.close()
    settle, calls = Ledger.settle, []

    def cut_off(self: Ledger, number: int, ticks: int) -> None:
        calls.append(number)
        if len(calls) == 2:
            raise Interruption
        settle(self, number, ticks)

    monkeypatch.setattr(Ledger, "settle", cut_off)
    with pytest.raises(Interruption):
        Ledger(path)
    monkeypatch.undo()
    with Ledger(path) as again:
        assert (again.spent_ticks("motion"), again.spent_ticks("idle")) == (3, 7)


def test_a_note_of_an_unwritten_entry_does_not_count_for_the_next(path: Path) -> None:
    ledger = Ledger(path)
    ledger._note_begun(1, 0)
    ledger._database.close()
    ledger._lock.close()
    ledger = Ledger(path)
    with contextlib.suppress(Interruption), ledger.reserve("reset", 50):
        raise Interruption
    ledger._database.close()
    ledger._lock.close()
    with Ledger(path) as again:
        assert again.spent_ticks("reset") == 50


def test_a_ledger_without_write_permission_can_be_read(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Ledger(path) as ledger, ledger.reserve("motion", 5) as entry:
        entry.settle(4)
    before = sorted(each.name for each in path.parent.iterdir())
    monkeypatch.setattr(os, "access", lambda *_: False)  # as root, no permission bits refuse
    assert read_accounts(path).spent["motion"] == 4
    assert sorted(each.name for each in path.parent.iterdir()) == before


def test_a_ledger_that_lost_its_newest_entries_is_named(path: Path) -> None:
    files = [path, path.with_name("ledger.sqlite-wal")]
    ledger = Ledger(path)
    with ledger.reserve("motion", 5) as entry:
        old = [file.read_bytes() for file in files]
        entry.settle(4)
    ledger._database.close()
    ledger._lock.close()
    for file, content in zip(files, old, strict=True):
        file.write_bytes(content)
    with pytest.raises(UserError, match=r"ledger\.sqlite lost its entries from 2 to 2"):
        Ledger(path)


def test_a_changed_entry_is_found(path: Path) -> None:
    with Ledger(path) as ledger:
        for ticks in (5, 6):
            with ledger.reserve("motion", ticks) as entry:
                entry.settle(ticks)
    connection = sqlite3.connect(path)
    connection.execute("DROP TRIGGER entry_UPDATE")
    connection.execute("UPDATE entry SET ticks = 1 WHERE id = 2")
    connection.execute(LEDGER.schema[1])
    connection.commit()
    connection.close()
    with pytest.raises(UserError, match="entry 2 has changed since it was written"):
        Ledger(path)


def test_grants_are_kept(path: Path) -> None:
    with Ledger(path) as ledger:
        budget = Budget(ledger, RobotTime(100, 0.04))
        ledger.grant(50)
        assert budget.total.ticks == 150
        with pytest.raises(ValueError, match="granted"):
            ledger.grant(0)
    with Ledger(path) as ledger:
        assert Budget(ledger, RobotTime(100, 0.04)).remaining.ticks == 150
        assert ledger.spent_ticks("motion") == 0


def test_an_error_inside_a_reservation_leaves_it_counted(path: Path) -> None:
    with Ledger(path) as ledger:
        with pytest.raises(RuntimeError), ledger.reserve("motion", 50):
            raise RuntimeError("the robot stopped")
        assert ledger.spent_ticks("motion") == 50


HOLD = """
import sys
from pathlib import Path
from iher_robot.storage.ledger import Ledger
ledger = Ledger(Path(sys.argv[1]))
print("held", flush=True)
sys.stdin.read()
"""


def test_a_second_process_is_refused(path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(UserError, match="in use"):
            Ledger(path)
        holder.kill()
        holder.wait()
    with Ledger(path) as ledger:
        assert ledger.spent_ticks("motion") == 0


def test_a_second_ledger_in_the_same_process_is_refused(path: Path) -> None:
    with Ledger(path), pytest.raises(UserError, match="in use"):
        Ledger(path)
    Ledger(path).close()


def test_the_ledger_is_append_only(path: Path) -> None:
    with Ledger(path) as ledger, ledger.reserve("motion", 5) as entry:
        entry.settle(4)
    connection = sqlite3.connect(path)
    for change in (
        "UPDATE entry SET ticks = 1",
        "DELETE FROM entry",
    ):
        with pytest.raises(sqlite3.IntegrityError, match="append-only"):
            connection.execute(change)
    connection.close()


def test_settling_checks_its_ticks_but_never_loses_any(path: Path) -> None:
    with Ledger(path) as ledger:
        with ledger.reserve("reset", 5) as entry:
            with pytest.raises(ValueError, match="-1"):
                entry.settle(-1)
            entry.settle(3)
            with pytest.raises(ValueError, match="already settled"):
                entry.settle(2)
        assert ledger.spent_ticks("reset") == 3
        with ledger.reserve("reset", 5) as entry:
            entry.settle(7)
        assert ledger.spent_ticks("reset") == 10


@pytest.mark.parametrize("ticks", [0, -3])
def test_a_reservation_is_at_least_one_tick(path: Path, ticks: int) -> None:
    with (
        Ledger(path) as ledger,
        pytest.raises(ValueError, match=f"not {ticks}"),
        ledger.reserve("motion", ticks),
    ):
        pass


def test_an_unknown_account_is_refused(path: Path) -> None:
    with (
        Ledger(path) as ledger,
        pytest.raises(ValueError, match="'moton', valid: motion"),
        ledger.reserve("moton", 1),  # type: ignore[arg-type]
    ):
        pass


@pytest.mark.parametrize("content", [b"not a database, though long enough" * 100, b"PK\x03\x04"])
def test_a_foreign_file_is_no_ledger(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with pytest.raises(UserError, match=r"ledger\.sqlite is no ledger"):
        Ledger(path)
    assert path.read_bytes() == content


def test_a_foreign_database_is_no_ledger(path: Path) -> None:
    connection = sqlite3.connect(path)
    connection.execute("CREATE TABLE reservation (id)")
    connection.close()
    with pytest.raises(UserError, match=r"ledger\.sqlite is no ledger"):
        Ledger(path)


def test_a_folder_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"absent/ledger\.lock"):
        Ledger(tmp_path / "absent" / "ledger.sqlite")


def test_the_budget_counts_motion_only_and_cannot_be_exceeded(path: Path) -> None:
    with Ledger(path) as ledger:
        budget = Budget(ledger, RobotTime(120, 0.04))
        with ledger.reserve("reset", 1000) as entry:
            entry.settle(1000)
        with budget.reserve(100) as entry:
            assert budget.remaining.ticks == 20
            entry.settle(70)
        assert budget.remaining.ticks == 50
        with pytest.raises(BudgetError, match="51 ticks requested, 50 remain"), budget.reserve(51):
            pass
        assert budget.remaining.ticks == 50
        with budget.reserve(50) as entry:
            entry.settle(50)
        assert budget.remaining.ticks == 0


def test_a_budget_below_the_spent_ticks_has_nothing_left(path: Path) -> None:
    with Ledger(path) as ledger:
        with ledger.reserve("motion", 50) as entry:
            entry.settle(50)
        assert Budget(ledger, RobotTime(20, 0.04)).remaining.ticks == 0
