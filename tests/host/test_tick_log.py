"""The tick log of a host: a line for each tick, and no effect of a bad disk on the robot."""

from __future__ import annotations

import json
import multiprocessing
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import EndEffectorCommand, SimulatedClock
from iher_robot import UserError
from iher_robot.host.control_loop import ControlLoop
from iher_robot.host.heartbeat import Heartbeat
from iher_robot.host.network.channels import Channel, channel_ends
from iher_robot.host.persistence import RobotMemory, RobotTotal
from iher_robot.host.serve import serve
from iher_robot.host.served_robot import ServedRobot
from iher_robot.host.settings import HostSettings
from iher_robot.host.tick_log import TickLog
from tests.drivers.fake_robot import FakeRobot
from tests.served.served_robot import eventually


class Bench:
    """A control loop without a gateway, with a tick log."""

    def __init__(self, folder: Path, log: TickLog, total: RobotTotal) -> None:
        clock = SimulatedClock(10**9)
        self.log, self.total = log, total
        self.robot = FakeRobot(clock=clock)
        memory = RobotMemory(folder)
        served = ServedRobot(lambda _: self.robot, "push", memory, (), clock)
        settings = HostSettings("fake", "fake", {}, ("tcp/127.0.0.1:1",), folder)
        self.ends = channel_ends()
        heartbeat = Heartbeat(multiprocessing.get_context("spawn"))
        heartbeat.beat()
        channel = Channel(self.ends[1])
        self.loop = ControlLoop(settings, served, total, memory, channel, heartbeat, clock, log)
        served.open()
        self.loop._schedule.start()

    def command(self) -> None:
        """Command the robot, as a client would."""
        answered = self.robot.measure().seq
        self.robot.command(EndEffectorCommand(answered, np.full(3, 0.01), np.zeros(2)))

    def arm(self) -> None:
        self.loop._lease.acquire("session", "a test")
        self.loop._deadman.restart()
        self.robot.arm()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with TickLog(tmp_path / "ticks.jsonl") as log, RobotTotal(tmp_path, "fake") as total:
        bench = Bench(tmp_path, log, total)
        yield bench
        for end in bench.ends:
            end.close()


def _lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_a_line_has_the_command_applied_in_its_tick(bench: Bench, tmp_path: Path) -> None:
    bench.loop.tick()
    bench.arm()
    bench.loop.tick()
    bench.command()
    answered = bench.robot.measure().seq
    bench.loop.tick()
    bench.loop.tick()
    bench.robot.stop("a person came near", "emergency_stop")
    bench.loop.tick()
    bench.log.close()
    lines = _lines(tmp_path / "ticks.jsonl")
    assert [line["armed"] for line in lines] == [False, True, True, True, False]
    assert [line["applied"] is not None for line in lines] == [False, False, True, False, False]
    applied = lines[2]["applied"]
    assert applied["kind"] == "ee_delta"
    assert applied["answers"] == lines[1]["seq"], "in the host's tick counter"
    assert answered != lines[1]["seq"]
    assert [line["token"] for line in lines] == [0, 1, 1, 1, 1]
    assert [line["fault"] for line in lines] == [None] * 4 + ["emergency_stop"]
    assert [line["mode"] for line in lines][1:] == ["held", "moving", "held", "stopped"]
    assert np.diff([line["seq"] for line in lines]).tolist() == [1, 1, 1, 1]
    assert {line["boot"] for line in lines} == {bench.loop.boot}
    assert all(line["utc"].endswith("+00:00") for line in lines)


def test_every_armed_tick_is_in_the_robots_account(bench: Bench, tmp_path: Path) -> None:
    bench.arm()
    for _ in range(7):
        bench.loop._deadman.restart()
        bench.loop.tick()
    bench.log.close()
    assert sum(line["armed"] for line in _lines(tmp_path / "ticks.jsonl")) == 7
    assert bench.total.spent()["motion"] == 7


def test_a_full_disk_is_counted_logged_once_and_delays_no_tick(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with TickLog(Path("/dev/full")) as log, RobotTotal(tmp_path, "fake") as total:
        bench = Bench(tmp_path, log, total)
        for _ in range(5):
            bench.loop.tick()
        assert eventually(lambda: log.lost == 5)
        assert bench.loop._timing()["ticks_not_logged"] == 5
        assert bench.robot.fault is None
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert "No space left on device" in caplog.text


class _Stuck:
    """A disk that does not answer."""

    def __init__(self) -> None:
        self.answers = threading.Event()
        self.written: list[bytes] = []

    def write(self, line: bytes) -> int:
        self.answers.wait(30.0)
        self.written.append(line)
        return len(line)

    def close(self) -> None: ...


def test_a_blocked_disk_delays_no_tick(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("iher_robot.host.tick_log._MAX_WAITING_LINES", 3)
    disk: Any = _Stuck()
    bench.log._file = disk
    for _ in range(10):
        bench.loop.tick()
    assert 10 - 3 - 1 <= bench.log.lost <= 10 - 3
    disk.answers.set()
    bench.log.close()
    assert len(disk.written) + bench.log.lost == 10


class _Cutting:
    """A disk with room for half a line, once."""

    def __init__(self, file: Any) -> None:
        self.file = file
        self.cut = False

    def write(self, line: bytes) -> int:
        if self.cut:
            return int(self.file.write(line))
        self.cut = True
        return int(self.file.write(line[: len(line) // 2]))

    def close(self) -> None:
        self.file.close()


def test_a_line_that_was_cut_off_damages_no_other(bench: Bench, tmp_path: Path) -> None:
    disk: Any = _Cutting(bench.log._file)
    bench.log._file = disk
    for _ in range(3):
        bench.loop.tick()
    bench.log.close()
    first, *whole = (tmp_path / "ticks.jsonl").read_text().splitlines()
    with pytest.raises(ValueError, match=r"."):
        json.loads(first)
    assert [json.loads(line)["seq"] for line in whole] == [
        bench.loop._robot.state().seq - 1,
        bench.loop._robot.state().seq,
    ]
    assert bench.log.lost == 1


@pytest.mark.parametrize(("left", "lines"), [("{}\n", 2), ('{"boot": "4', 2), ("", 1)])
def test_a_log_is_appended_to(tmp_path: Path, left: str, lines: int) -> None:
    path = tmp_path / "ticks.jsonl"
    path.write_text(left)
    with TickLog(path) as log, RobotTotal(tmp_path, "fake") as total:
        Bench(tmp_path, log, total).loop.tick()
    found = path.read_text().splitlines()
    assert len(found) == lines
    assert path.read_text().startswith(left)
    assert json.loads(found[-1])["armed"] is False


def test_a_log_that_cannot_be_opened_is_refused_in_one_sentence(tmp_path: Path) -> None:
    where = tmp_path / "nowhere" / "ticks.jsonl"
    with pytest.raises(UserError, match="--tick-log") as refused:
        serve(
            driver="mujoco", memory=tmp_path, tick_log=where, listen=["tcp/127.0.0.1:0"], echo=print
        )
    message = str(refused.value)
    assert str(where) in message
    assert "No such file or directory" in message
    assert "\n" not in message
