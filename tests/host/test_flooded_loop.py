"""The control loop of a host under more messages than it can handle."""

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


def test_a_tick_ends_during_a_flood_of_messages(loop: ControlLoop) -> None:
    for _ in range(FLOOD):
        loop._inbox.put(ChannelMessage("command", body=b"no command"))
    loop._handle_until(0)
    handled = loop._commands.refusals["malformed"]
    assert 0 < handled <= FEW, "messages that wait at the end of a tick do not delay it"
    loop._handle_until(0)
    assert loop._commands.refusals["malformed"] == 2 * handled, "the others are handled later"
