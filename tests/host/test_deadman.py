"""The deadman: a client is killed, freezes, disconnects or falls silent while the robot moves."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest

from drivers import Mode
from tests.repository import ROOT
from tests.served.observer import Observer
from tests.served.served_robot import ServedRobot, eventually

pytestmark = pytest.mark.real_time

WATCHDOG_TICKS = 5  # 0.2 s
BRAKING_TICKS = 2
MOVING = 0.2  # rad/s and m/s
STILL = 5e-3


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedRobot]:
    with ServedRobot(tmp_path_factory.mktemp("memory")) as host:
        yield host


def _mover(served: ServedRobot, how: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "tests.served.mover", served.endpoint, how],
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )


def _wait_for_motion(mover: subprocess.Popen[str], ticks: int) -> None:
    assert mover.stdout is not None
    for line in mover.stdout:
        if int(line) >= ticks:
            return
    raise AssertionError("the mover ended before it moved")


@pytest.mark.parametrize("how", ["killed", "frozen", "silent", "disconnected"])
def test_the_joints_stop_within_the_watchdogs_time(served: ServedRobot, how: str) -> None:
    mover = _mover(served, how if how in ("silent", "disconnected") else "never")
    try:
        with Observer(served.endpoint) as observer:
            _wait_for_motion(mover, 30)
            if how == "killed":
                mover.kill()
            elif how == "frozen":
                mover.send_signal(signal.SIGSTOP)
            assert eventually(lambda: bool(observer.newest[1].disarmed_because), 15.0), (
                "a client that falls silent is disarmed"
            )
            tripped = len(observer.seen)
            assert eventually(lambda: len(observer.seen) > tripped + 15)
            states = [state for state, _ in observer.seen]
            armed = [info.armed for _, info in observer.seen]
    finally:
        mover.kill()
        mover.wait(10.0)
    trip = max(i for i, is_armed in enumerate(armed) if is_armed) + 1
    speeds = [float(np.abs(state.dq).max()) for state in states]
    assert max(speeds[:trip]) > MOVING, "it moved before"
    moved = [i for i, state in enumerate(states) if state.mode is Mode.MOVING]
    silent_from = max(moved) + 1
    assert states[trip].seq - states[silent_from].seq <= WATCHDOG_TICKS + 1, (
        "the host disarms a client after the watchdog's time of silence"
    )
    still = speeds[silent_from + WATCHDOG_TICKS :]
    assert max(still) < STILL, f"joint speeds after the watchdog's time: {still}"
    first = silent_from + BRAKING_TICKS
    drift = max(float(np.abs(state.q - states[first].q).max()) for state in states[first + 3 :])
    assert drift < 0.02, f"the joints went on by {drift} rad"


def test_a_client_that_resumes_after_a_freeze_is_disarmed(served: ServedRobot) -> None:
    mover = _mover(served, "never")
    try:
        with Observer(served.endpoint) as observer:
            _wait_for_motion(mover, 20)
            mover.send_signal(signal.SIGSTOP)
            assert eventually(lambda: bool(observer.newest[1].disarmed_because), 15.0)
            before = observer.newest[0]
            mover.send_signal(signal.SIGCONT)
            assert eventually(lambda: observer.newest[0].seq > before.seq + 25)
            after = [(s, i) for s, i in observer.seen if s.seq > before.seq]
        assert not any(info.armed for _, info in after), "a freeze ends what was armed before it"
        assert not any(state.mode is Mode.MOVING for state, _ in after)
    finally:
        mover.kill()
        mover.wait(10.0)
