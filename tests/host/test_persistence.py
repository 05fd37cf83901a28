"""State of a robot that survives restarts of its host."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from drivers.gate import Fault
from iher_robot import UserError
from iher_robot.host.persistence import RobotMemory, RobotTotal


def test_a_fault_is_remembered_until_it_is_cleared(tmp_path: Path) -> None:
    RobotMemory(tmp_path).save_fault(lambda: Fault("emergency_stop", "someone walked in", 5))
    remembered = RobotMemory(tmp_path).fault
    assert remembered is not None
    assert (remembered.name, remembered.reason) == ("emergency_stop", "someone walked in")
    RobotMemory(tmp_path).save_fault(lambda: None)
    assert RobotMemory(tmp_path).fault is None


def test_the_tick_counter_never_goes_back(tmp_path: Path) -> None:
    memory = RobotMemory(tmp_path)
    for tick in (1, 2, 99_999, 100_000, 250_000):
        memory.reserve_ticks(tick)
        assert RobotMemory(tmp_path).ticks > tick, "a ceiling is written before it is reached"


@pytest.mark.parametrize(
    "text", ["", "[]", '{"ticks": 3}', '{"ticks": "3", "fault": null}', '{"ticks": 1, "fault": 2}']
)
def test_a_damaged_file_is_an_error_not_a_robot_without_faults(tmp_path: Path, text: str) -> None:
    (tmp_path / "robot.json").write_text(text)
    with pytest.raises(UserError, match=r"robot\.json is damaged"):
        RobotMemory(tmp_path)


def test_ticks_are_counted_over_restarts(tmp_path: Path) -> None:
    with RobotTotal(tmp_path, "fetch") as total:
        total.reserve("motion")
        for _ in range(620):
            total.tick("motion")
        with total.reserve_at_most("reset", 3000) as entry:
            entry.settle(7)
        assert (total.spent()["motion"], total.spent()["reset"]) == (620, 7)
    with RobotTotal(tmp_path, "fetch") as total:
        assert (total.spent()["motion"], total.spent()["reset"]) == (620, 7)


def crash(total: RobotTotal) -> None:
    """End as when its process dies: nothing is settled."""
    total._ledger.close()


def test_a_crash_of_the_host_counts_the_ticks_that_had_begun(tmp_path: Path) -> None:
    total = RobotTotal(tmp_path, "fetch")
    total.reserve("motion")
    for _ in range(60):
        total.tick("motion")
    crash(total)
    with RobotTotal(tmp_path, "fetch") as again:
        assert again.spent()["motion"] == 60


def test_a_crash_of_the_machine_never_counts_too_few_ticks(tmp_path: Path) -> None:
    total = RobotTotal(tmp_path, "fetch")
    for _ in range(60):
        total.tick("motion")
    crash(total)
    (tmp_path / "total.lock").unlink()  # after a restart of the machine it is not valid
    with RobotTotal(tmp_path, "fetch") as again:
        assert 60 <= again.spent()["motion"] <= 600


def test_a_crash_in_a_reset_counts_the_longest_one(tmp_path: Path) -> None:
    total = RobotTotal(tmp_path, "fetch")
    with pytest.raises(KeyboardInterrupt), total.reserve_at_most("reset", 3000):
        raise KeyboardInterrupt
    assert total.spent()["reset"] == 3000
    crash(total)
    with RobotTotal(tmp_path, "fetch") as again:
        assert again.spent()["reset"] == 3000


def test_two_hosts_of_one_robot_are_refused(tmp_path: Path) -> None:
    with RobotTotal(tmp_path, "fetch"), pytest.raises(UserError, match="served by another process"):
        RobotTotal(tmp_path, "fetch")


def test_a_stop_may_be_written_while_the_loop_writes(tmp_path: Path) -> None:
    memory, problems = RobotMemory(tmp_path), []

    def keep() -> None:
        try:
            for index in range(50):
                fault = Fault("f", f"{threading.get_ident()} {index}", 0)
                memory.save_fault(lambda fault=fault: fault)  # type: ignore[misc]
        except UserError as error:
            problems.append(error)

    threads = [threading.Thread(target=keep) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30.0)
    assert problems == []
    assert RobotMemory(tmp_path).fault == memory.fault
