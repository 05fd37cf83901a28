"""Commands that reach the robot, and the reasons for which others are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers import EndEffectorCommand, SimulatedClock
from drivers.remote.messages import command_fields
from drivers.wire import pack
from iher_robot.host.commands import CommandHandler
from iher_robot.host.lease import HostLease, SilenceTimer
from iher_robot.host.persistence import RobotMemory
from iher_robot.host.served_robot import ServedRobot
from tests.drivers.fake_robot import FakeRobot

PERIOD_NS = 40_000_000


class Bench:
    """A command handler with a fake robot, open, leased and armed."""

    def __init__(self, folder: Path) -> None:
        self.clock = SimulatedClock(10**9)
        self.robot = ServedRobot(lambda _: FakeRobot(), "push", RobotMemory(folder), (), self.clock)
        self.robot.open()
        self.lease = HostLease("fake", 2.0, self.clock)
        self.deadman = SilenceTimer(0.2, self.clock)
        self.handler = CommandHandler("boot", self.robot, self.lease, self.deadman, self.clock, 2.0)
        self.token = self.lease.acquire("session", "a test")
        self.robot.driver.arm()
        self.publish()

    def publish(self) -> int:
        seq = self.robot.state().seq
        self.handler.published(seq)
        return seq

    def tick(self) -> int:
        self.robot.driver.advance()
        self.clock.advance_ns(PERIOD_NS)
        return self.publish()

    def send(self, **changes: object) -> None:
        command = EndEffectorCommand(0, np.array([0.001, 0.0, 0.0]), np.zeros(2))
        content = {"v": 1, "boot": "boot", "token": self.token, "n": self.lease.n + 1}
        seq = self.robot.state().seq
        self.handler.take(pack(content | {"answers": seq} | command_fields(command) | changes))

    def applied(self) -> bool:
        """End the tick; return whether a command was applied in it."""
        seq = self.tick()
        applied = self.robot.state().applied
        return applied is not None and applied.tick == seq


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def test_a_valid_command_is_applied_and_answers_the_published_state(bench: Bench) -> None:
    seq = bench.robot.state().seq
    bench.send()
    assert bench.applied()
    state = bench.robot.state()
    assert state.applied is not None
    assert state.applied.command.answers == seq
    assert bench.handler.refusals == {}


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"boot": "another"}, "wrong_boot"),
        ({"token": 99}, "wrong_token"),
        ({"token": 0}, "wrong_token"),
        ({"n": 0}, "repeated"),
        ({"answers": 10**6}, "expired"),
        ({"v": 2}, "version"),
        ({"kind": "teleport"}, "malformed"),
        ({"extra": 1}, "malformed"),
        ({"delta_pos": [0.0, 0.0, 0.0]}, "malformed"),
        ({"delta_pos": ["<f4", [3], bytes(12)]}, "malformed"),
        ({"delta_pos": np.zeros(2)}, "invalid"),
        ({"delta_pos": np.array([np.nan, 0.0, 0.0])}, "invalid"),
    ],
)
def test_an_invalid_command_is_refused_counted_and_not_applied(
    bench: Bench, changes: dict[str, object], reason: str
) -> None:
    bench.send(**changes)
    assert bench.handler.refusals == {reason: 1}
    assert not bench.applied()
    bench.send()
    assert bench.applied(), "an invalid command does not affect a later valid one"


def test_a_command_is_applied_once(bench: Bench) -> None:
    bench.send(n=5)
    assert bench.applied()
    bench.send(n=5)
    bench.send(n=4)
    assert not bench.applied()
    assert bench.handler.refusals == {"repeated": 2}


def test_a_command_expires_two_ticks_after_the_state_that_it_answers(bench: Bench) -> None:
    seq = bench.robot.state().seq
    bench.tick()
    bench.tick()
    bench.send(answers=seq)
    assert bench.applied(), "two ticks old is not too old"
    seq = bench.robot.state().seq
    bench.tick()
    bench.tick()
    bench.clock.advance_ns(1)
    bench.send(answers=seq)
    assert bench.handler.refusals == {"expired": 1}
    assert not bench.applied()


def test_a_hold_moves_nothing_and_restarts_the_deadman(bench: Bench) -> None:
    bench.clock.advance_ns(150_000_000)
    content = {"v": 1, "kind": "hold", "boot": "boot", "token": bench.token, "n": 1, "answers": 0}
    bench.handler.take(pack(content))
    bench.clock.advance_ns(150_000_000)
    assert not bench.deadman.expired
    assert not bench.applied()
    assert bench.lease.n == 1


@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    data=st.one_of(
        st.binary(max_size=400),
        st.recursive(
            st.none()
            | st.booleans()
            | st.integers()
            | st.floats()
            | st.text(max_size=9)
            | st.binary(max_size=30),
            lambda inner: (
                st.lists(inner, max_size=4)
                | st.dictionaries(st.text(max_size=9), inner, max_size=5)
            ),
            max_leaves=20,
        ),
    )
)
def test_random_messages_are_refused_and_never_raise(bench: Bench, data: object) -> None:
    import msgpack  # type: ignore[import-untyped]

    try:
        body = data if isinstance(data, bytes) else msgpack.packb(data)
    except (OverflowError, ValueError):
        return
    before = sum(bench.handler.refusals.values())
    bench.handler.take(body)
    assert sum(bench.handler.refusals.values()) == before + 1
    assert not bench.applied()
