"""Ticks of a host's control loop that count as late."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers import ResetRequest, ResetResult, SimulatedClock
from drivers.remote.messages import Empty, LeaseRequest, Reply, ResetMessage
from drivers.wire import Message, pack, unpack
from iher_robot.host.control_loop import ControlLoop
from iher_robot.host.heartbeat import Heartbeat
from iher_robot.host.network.channels import Channel, ChannelMessage, channel_ends
from iher_robot.host.persistence import RobotMemory, RobotTotal
from iher_robot.host.served_robot import ServedRobot
from iher_robot.host.settings import HostSettings
from tests.drivers.fake_robot import PERIOD_NS, FakeRobot


class Robot(FakeRobot):
    """A robot whose ticks and resets take time on the host's clock."""

    def __init__(self, clock: SimulatedClock) -> None:
        super().__init__(clock=clock)
        self.time = clock
        self.late_ns = 0

    def _advance(self) -> None:
        super()._advance()
        self.time.advance_ns(self.late_ns)

    def _reset(self, request: ResetRequest) -> ResetResult:
        self.time.advance_ns(25 * PERIOD_NS)
        return super()._reset(request)


class Bench:
    """A control loop without a gateway, which gets requests directly."""

    def __init__(self, folder: Path, total: RobotTotal) -> None:
        self.clock = SimulatedClock(10**9)
        self.robot = Robot(self.clock)
        memory = RobotMemory(folder)
        served = ServedRobot(lambda _: self.robot, "push", memory, (), self.clock)
        settings = HostSettings("fake", "fake", {}, ("tcp/127.0.0.1:1",), folder)
        self._ends = channel_ends()
        self._gateway = Channel(self._ends[0])
        channel, heartbeat = Channel(self._ends[1]), Heartbeat(multiprocessing.get_context("spawn"))
        heartbeat.beat()
        self.loop = ControlLoop(settings, served, total, memory, channel, heartbeat, self.clock)
        served.open()
        self.loop._schedule.start()
        self.loop._publish()

    def ask(self, name: str, message: Message) -> Reply:
        """Send a request, and run the tick in which it is answered."""
        self.loop._inbox.put(ChannelMessage("request", 1, name, pack(message)))
        self.loop.tick()
        while True:
            note = self._gateway.receive()
            assert note is not None
            if note.kind == "reply":
                return unpack(Reply, note.body)

    @property
    def overruns(self) -> int:
        return int(self.ask("status", Empty()).result["tick_overruns"])

    def close(self) -> None:
        for end in self._ends:
            end.close()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with RobotTotal(tmp_path, "fake") as total:
        bench = Bench(tmp_path, total)
        yield bench
        bench.close()


def test_a_tick_that_ends_a_period_late_is_an_overrun(bench: Bench) -> None:
    assert bench.overruns == 0
    bench.robot.late_ns = 2 * PERIOD_NS
    bench.loop.tick()
    bench.robot.late_ns = 0
    bench.loop.tick()
    assert bench.overruns == 1, "ticks are not made up for"


def test_a_reset_takes_its_time_and_is_no_late_tick(bench: Bench) -> None:
    lease = LeaseRequest(op="acquire", session="s", holder="a test", scene="push")
    reply = bench.ask("lease", lease)
    token = reply.result["token"]
    before = bench.clock.now_ns()
    reply = bench.ask("reset", ResetMessage(boot=reply.boot, token=token, objects={}, seed=0))
    assert reply.ok, reply
    assert bench.clock.now_ns() - before > 20 * PERIOD_NS, "it took many periods"
    bench.loop.tick()
    assert bench.overruns == 0
    assert bench.ask("status", Empty()).result["tick_late_p99_ms"] == pytest.approx(0.0)
