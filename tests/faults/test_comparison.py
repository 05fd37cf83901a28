"""The harness finds every kind of violation."""

from __future__ import annotations

import json
import time
from collections import Counter
from pathlib import Path

import pytest

from tests.faults.campaign import deal
from tests.faults.folder_watch import FolderWatch
from tests.faults.host_log import HostLog, LoggedTick
from tests.faults.moments import Kind
from tests.faults.run_folder import Found, Witness, compare
from tests.faults.violation import Violation


def _ticks(*seqs: int) -> list[LoggedTick]:
    return [LoggedTick(seq, 1, True, True, 0) for seq in seqs]


def _found(covered: list[int], spent: int, valid: set[int] | None = None) -> Found:
    return Found(
        {"motion": spent, "evaluation": 0},
        Counter(covered),
        set(covered) if valid is None else valid,
    )


KILLED = Witness.of([_ticks(1, 2, 3), _ticks(7, 8)])


def test_ticks_in_flight_may_be_missing_and_be_counted() -> None:
    assert compare(_found([1, 2, 3, 7, 8], 5), KILLED, kills=2) == 0
    assert compare(_found([1, 2, 7], 5), KILLED, kills=2) == 0
    assert compare(_found([1, 2, 3, 7, 8], 7), KILLED, kills=2) == 2


@pytest.mark.parametrize(
    ("found", "complaint"),
    [
        (_found([1, 3, 7, 8], 5), r"ticks \[2\] are missing"),
        (_found([1, 2, 3, 8], 5), r"ticks \[7\] are missing"),
        (_found([1, 2, 2, 3, 7, 8], 6), r"ticks \[2\] are stored more than once"),
        (_found([1, 2, 3, 7, 8, 9], 6), r"ticks \[9\] are stored, but no command"),
        (_found([1, 2, 3, 7, 8], 4), "but 5 ticks have passed"),
        (_found([1, 2, 7], 4), "but 5 ticks have passed"),
        (_found([1, 2, 3, 7, 8], 8), "3 more than the 5 ticks"),
    ],
)
def test_what_is_missing_repeated_invented_or_miscounted_is_a_violation(
    found: Found, complaint: str
) -> None:
    with pytest.raises(Violation, match=complaint):
        compare(found, KILLED, kills=2)


def test_a_run_that_was_not_killed_has_every_tick() -> None:
    unharmed = Witness.of([], _ticks(1, 2, 3))
    assert compare(_found([1, 2, 3], 3), unharmed, kills=0) == 0
    with pytest.raises(Violation, match=r"ticks \[3\] are missing"):
        compare(_found([1, 2], 3), unharmed, kills=0)


def test_a_held_tick_is_charged_and_not_learned_from() -> None:
    assert compare(_found([1, 2, 3, 4, 7, 8], 6, valid={1, 2, 3, 7, 8}), KILLED, kills=2) == 0


def _line(seq: int, boot: str = "a") -> str:
    fields = {"boot": boot, "seq": seq, "token": 1, "armed": True, "host_ns": time.monotonic_ns()}
    return json.dumps(fields | {"applied": {"answers": seq - 1}}) + "\n"


def test_a_log_is_read_line_by_line_while_it_is_written(tmp_path: Path) -> None:
    path = tmp_path / "ticks.jsonl"
    first, second = _line(4), _line(5)
    path.write_text(first + second[:20])
    log = HostLog(path)
    assert [tick.seq for tick in log.read()] == [4]
    path.write_text(first + second)
    assert [tick.seq for tick in log.read()] == [5]
    assert [tick.commanded for tick in log.ticks] == [True, True]


@pytest.mark.parametrize("line", [_line(6), _line(4), _line(5, boot="b")])
def test_a_log_with_a_hole_proves_nothing(tmp_path: Path, line: str) -> None:
    path = tmp_path / "ticks.jsonl"
    path.write_text(_line(4) + line)
    with pytest.raises(Violation):
        HostLog(path).read()


def test_a_file_that_vanishes_at_once_is_reported(tmp_path: Path) -> None:
    with FolderWatch(tmp_path) as watch:
        assert watch.wait(0.0) == []
        (tmp_path / ".a.tmp").write_text("")
        (tmp_path / ".a.tmp").replace(tmp_path / "a")
        assert watch.wait(1.0) == [".a.tmp", "a"]


def test_every_kind_of_kill_has_its_share() -> None:
    dealt = Counter(deal(100, seed=3))
    assert dealt.total() == 100
    assert dealt == Counter(deal(100, seed=4)), "only the order is drawn"
    assert deal(100, seed=3) != deal(100, seed=4)
    assert min(dealt[kind] for kind in Kind) >= 8
