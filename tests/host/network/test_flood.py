"""100,000 messages that must be refused, while a client moves the robot."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import zenoh

from drivers import (
    Command,
    EndEffectorCommand,
    JointCommand,
    LifecycleError,
    LinkLost,
    ResetRequest,
    StaleState,
)
from drivers.remote import ZenohDriver
from drivers.remote.messages import Empty
from drivers.wire import pack
from iher_robot.env.controller import make_controller
from tests.repository import ROOT
from tests.served.hostile import ANY
from tests.served.limits import assert_within_limits
from tests.served.observer import Observer
from tests.served.served_robot import PATIENT, ServedRobot, eventually

pytestmark = pytest.mark.real_time

COUNT = 100_000
BURST = 50_000
OVERRUNS = ("overrun", "request_overrun", "object_overrun")
TICKS = 60


def test_a_flood_is_refused_and_counted_while_valid_commands_move_the_robot(tmp_path: Path) -> None:
    with (
        ServedRobot(tmp_path, *PATIENT) as served,
        Observer(served.endpoint) as observer,
    ):
        driver = served.driver()
        driver.open()
        driver.reset(ResetRequest())
        driver.arm()
        begun = len(observer.seen)
        flood = subprocess.Popen(
            [sys.executable, "-m", "tests.served.flooder", served.endpoint, str(COUNT)],
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        )
        try:
            _move_while_it_runs(driver, flood)
            printed, _ = flood.communicate()
        finally:
            flood.kill()
        assert flood.returncode == 0
        seen = observer.seen[begun:]
        status = observer.client.request("status", Empty(), 10.0).result
        driver.close()
    sent, refused = Counter(json.loads(printed)), Counter(status["refusals"])
    assert_within_limits(seen, observer.spec)
    applied = sum(s.applied is not None and s.applied.tick == s.seq for s, _ in seen)
    assert sum(sent.values()) == COUNT
    for late in ("expired", "disarmed"):  # of the client that moves, on a busy machine
        assert late not in sent
        refused.pop(late, None)
    assert refused.total() == COUNT, "each message is counted once"
    # On a busy machine the gateway refuses some unread.
    unread = sum(refused[reason] for reason in OVERRUNS)
    assert unread <= 0.1 * COUNT
    sent.pop(ANY, None)
    assert (sent - refused).total() <= unread, "each message is counted under its reason"
    assert len(seen) > 100
    assert applied >= 0.8 * len(seen), "meanwhile valid commands move the robot"
    assert status["fault"] is None


def _move_while_it_runs(driver: ZenohDriver, process: subprocess.Popen[str]) -> None:
    controller = make_controller(driver.spec, True)
    tick = 0
    while process.poll() is None:
        try:
            if not driver.is_armed:  # a busy machine has delayed this client
                driver.arm()
            action = 0.5 * np.array([np.cos(tick / 4), np.sin(tick / 4), 0.0, 0.0])
            driver.command(controller.command(action, driver.read()))
            driver.advance()
            tick += 1
        except (StaleState, LinkLost, LifecycleError):
            continue


@pytest.mark.parametrize(
    ("key", "kind"), [("cmd", ""), ("stop", "request_"), ("object/x", "object_")]
)
def test_a_burst_beyond_capacity_is_counted(tmp_path: Path, key: str, kind: str) -> None:
    with ServedRobot(tmp_path) as served, Observer(served.endpoint) as observer:
        publisher = observer.client._session.declare_publisher(
            f"iher/v1/fetch/{key}", congestion_control=zenoh.CongestionControl.BLOCK
        )
        for _ in range(BURST):
            publisher.put(pack({"v": 2}))

        def refused() -> Counter[str]:
            return Counter(observer.client.request("status", Empty(), 10.0).result["refusals"])

        assert eventually(lambda: refused().total() >= BURST)
        assert refused() <= Counter({f"{kind}version": BURST, f"{kind}overrun": BURST})
        assert refused().total() == BURST
        assert refused()[f"{kind}version"] > 0


def test_invalid_commands_with_the_lease_are_refused_and_excessive_ones_cut(
    tmp_path: Path,
) -> None:
    sent: Counter[str] = Counter()
    with (
        ServedRobot(tmp_path, *PATIENT) as served,
        Observer(served.endpoint) as observer,
    ):
        driver = served.driver()
        controller = make_controller(driver.spec, True)
        driver.open()
        driver.reset(ResetRequest())
        driver.arm()
        for tick in range(TICKS):
            state = driver.read()
            action = 0.5 * np.array([np.cos(tick / 4), np.sin(tick / 4), 0.0, 0.0])
            command = controller.command(action, state)
            assert isinstance(command, JointCommand)
            for reason, wrong in _wrong(command):
                assert driver._client is not None
                driver._sent += 1
                driver._client.send(driver._packed(wrong, driver._sent, wrong.answers))
                sent[reason] += 1
            if tick % 10 == 0:
                huge = np.full_like(command.q_target, 1e300)
                command = dataclasses.replace(command, q_target=huge, dq=-huge)
            driver.command(command)
            driver.advance()
        driver.close()
        status = observer.client.request("status", Empty(), 10.0).result
        seen = [(state, info) for state, info in observer.seen if info.armed]
    refused = Counter(status["refusals"])
    assert refused.keys() == sent.keys()
    # A busy link drops some, and on a busy machine others expire.
    assert refused["invalid"] <= sent["invalid"], "only invalid commands are refused as invalid"
    assert 0.9 * sent.total() <= refused.total() <= sent.total() + 0.2 * TICKS
    assert status["clips"], "excessive commands are cut"
    assert_within_limits(seen, driver.spec)
    applied = [s.applied for s, _ in seen if s.applied is not None and s.applied.tick == s.seq]
    assert len(applied) >= 0.8 * TICKS
    assert all(isinstance(each.command, JointCommand) for each in applied)


def _wrong(command: JointCommand) -> list[tuple[str, Command]]:
    """Commands that only the robot's own check can refuse, with the reason."""
    few = command.q_target[1:]
    return [
        ("expired", dataclasses.replace(command, answers=max(0, command.answers - 10))),
        ("expired", dataclasses.replace(command, answers=command.answers + 10**6)),
        ("invalid", dataclasses.replace(command, dq=np.full_like(command.dq, np.nan))),
        ("invalid", dataclasses.replace(command, duration_s=float("inf"))),
        ("invalid", dataclasses.replace(command, q_target=few)),
        ("invalid", EndEffectorCommand(command.answers, np.full(3, 0.01), np.zeros(2))),
    ]
