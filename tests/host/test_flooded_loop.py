"""What a host's control loop does with more than it can deal with."""

from __future__ import annotations

from pathlib import Path

import pytest

from iher_robot.host.control_loop import ControlLoop
from iher_robot.host.network.channels import ChannelMessage
from iher_robot.host.persistence import RobotTotal
from tests.host.test_timing import Bench

FLOOD = 5000
FEW = 100


@pytest.fixture
def loop(tmp_path: Path) -> ControlLoop:
    with RobotTotal(tmp_path, "fake") as total:
        return Bench(tmp_path, total).loop


def test_a_tick_ends_whatever_waits(loop: ControlLoop) -> None:
    for _ in range(FLOOD):
        loop._inbox.put(ChannelMessage("command", body=b"no command"))
    loop._handle_until(0)
    dealt_with = loop._commands.refusals["malformed"]
    assert 0 < dealt_with <= FEW, "what waits at the end of a tick does not put it off"
    loop._handle_until(0)
    assert loop._commands.refusals["malformed"] == 2 * dealt_with, "and is dealt with later"
