"""Findings of the doctor, from measurements."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from drivers import LinkLost, RobotState
from drivers.remote import LinkQuality
from drivers.remote.messages import Reply
from drivers.remote.state_message import HostInfo, pack_state
from drivers.remote.state_stream import StateListener, StateStream
from drivers.remote.status import HostStatus, printable, read_status
from iher_robot.deployment.diagnosis import Examination, Remote
from iher_robot.version import __version__
from tests.drivers.fake_robot import PERIOD_NS, FakeRobot, fake_spec

STATUS: Mapping[str, Any] = {
    "robot": "fake",
    "mode": "disarmed",
    "armed": False,
    "fault": None,
    "control_period_s": 0.04,
    "version": __version__,
    "total_ticks": {"motion": 1500, "reset": 750},
    "tick_late_p50_ms": 0.5,
    "tick_late_p99_ms": 2.0,
}


def measured() -> RobotState:
    with FakeRobot() as robot:
        return robot.measure()


def remote(*, p99_ms: float = 2.0, lost: int = 0, overruns: int = 0, **changes: Any) -> Remote:
    count, lost_states = changes.pop("count", 50), changes.pop("lost_states", 0)
    malformed = changes.pop("malformed", 0)
    states = StateStream(count, lost_states, malformed, 25.0, 0.2, measured(), 0)
    status = HostStatus.model_validate({**STATUS, **changes})
    return Remote(status, LinkQuality(100, lost, 1.0, p99_ms, 0.1), states, overruns)


def examined(**changes: Any) -> Examination:
    healthy: dict[str, Any] = {
        "spec": fake_spec(),
        "state": measured(),
        "now_ns": 0,
        "homed": True,
        "fault": None,
        "remote": remote(),
    }
    return Examination(**healthy | changes)


def test_a_healthy_robot_has_no_findings() -> None:
    assert examined().findings() == []
    facts = examined().facts()
    assert facts["robot time"] == "1.50 minutes in total: motion 1.00, reset 0.50"
    assert facts["used by"] == "no client"


def test_a_host_with_a_minimal_status_is_examined() -> None:
    least = {key: STATUS[key] for key in ("robot", "mode", "armed", "fault", "control_period_s")}
    status = HostStatus.model_validate(least)
    assert examined(remote=dataclasses.replace(remote(), status=status)).findings() == []


@pytest.mark.parametrize(
    ("changes", "finding"),
    [
        ({"p99_ms": 20.1}, "half a control period"),
        ({"p99_ms": float("nan")}, "half a control period"),
        ({"lost": 3}, "3 of 100 round trips"),
        ({"lost_states": 2}, "2 of 52 states"),
        ({"count": 0}, "no state arrived"),
        ({"malformed": 4}, "4 messages"),
        ({"overruns": 1}, "1 overran"),
        ({"tick_late_p99_ms": 21.0}, "21.0 ms"),
        ({"version": "0.0.1"}, "version 0.0.1"),
    ],
)
def test_each_problem_of_host_or_link_is_one_finding(changes: dict[str, Any], finding: str) -> None:
    (found,) = examined(remote=remote(**changes)).findings()
    assert finding in found
    assert "; " in found, "it says what to do"


@pytest.mark.parametrize(
    ("changes", "finding"),
    [
        ({"fault": ("panic", "pressed")}, "clear-fault panic"),
        ({"spec": dataclasses.replace(fake_spec(), enforces_joint_limits=False)}, "joint limits"),
        ({"now_ns": 300_000_000}, "the pose of object0 is 0.3 s old"),
        (
            {"state": dataclasses.replace(measured(), objects={})},
            "no pose of object0 was received",
        ),
        ({"state": dataclasses.replace(measured(), q=np.array([1.5]))}, "shoulder"),
        ({"state": dataclasses.replace(measured(), ee_pos=np.zeros(3))}, "from home"),
    ],
)
def test_each_problem_of_a_robot_is_one_finding(changes: dict[str, Any], finding: str) -> None:
    (found,) = examined(**changes).findings()
    assert finding in found
    assert "; " in found, "it says what to do"


def test_a_robot_that_was_not_brought_home_may_be_anywhere() -> None:
    away = dataclasses.replace(measured(), ee_pos=np.zeros(3))
    assert examined(state=away, homed=False).findings() == []


def listened(seqs: list[int], skipped: int = 0) -> StateStream:
    listener, state = StateListener(fake_spec()), measured()
    info = HostInfo("boot", 0, 0, 0, False, "", None, {}, {})
    for seq in seqs:
        data = pack_state(dataclasses.replace(state, seq=seq), info)
        listener.take(data, seq * PERIOD_NS)
    return listener.result(skipped)


def test_missing_states_are_counted() -> None:
    assert listened([5, 6, 7, 8]).lost == 0
    assert listened([5, 6, 9, 10]).lost == 2
    assert listened([5, 6, 9, 10], skipped=2).lost == 0, "in a reset none is sent"
    assert listened([5, 5, 6]).lost == 0, "a duplicate replaces no other state"
    assert listened([6, 5, 7]).lost == 0, "a late state is not lost"
    assert listened([]).count == 0


def test_rate_and_jitter_of_states() -> None:
    even = listened([1, 2, 3, 4])
    assert even.rate_hz == pytest.approx(25.0)
    assert even.jitter_ms == pytest.approx(0.0)
    assert listened([1, 2, 4, 5]).jitter_ms > 1.0
    assert listened([1]).rate_hz == 0.0


def test_a_malformed_message_is_counted_and_dropped() -> None:
    listener = StateListener(fake_spec())
    listener.take(b"nonsense", 0)
    result = listener.result()
    assert (result.count, result.malformed, result.newest) == (0, 1, None)


class Client:
    """Answers a status request with a given result."""

    class options:  # noqa: N801
        robot = "fake"

    def __init__(self, result: dict[str, Any]) -> None:
        self._result = result

    def request(self, *_: object) -> Reply:
        return Reply(ok=True, boot="boot", seq=0, result=self._result)


@pytest.mark.parametrize(
    "change",
    [
        {"mode": 3},
        {"armed": "yes"},
        {"fault": {"name": "x"}},
        {"control_period_s": 0.0},
        {"control_period_s": float("nan")},
        {"total_ticks": {"motion": -1}},
        {"refusals": "many"},
        {"holder": "x" * 1000},
    ],
)
def test_a_status_of_another_protocol_is_a_lost_link(change: dict[str, Any]) -> None:
    with pytest.raises(LinkLost, match=next(iter(change))):
        read_status(Client({**STATUS, **change}))  # type: ignore[arg-type]
    assert read_status(Client({**STATUS, "more": 1})).mode == "disarmed"  # type: ignore[arg-type]


def test_text_from_the_network_is_printable() -> None:
    assert printable("größe 5 µm") == "größe 5 µm"
    assert printable("\x1b[2J\n\u202eevil\udcff").isprintable()
