"""The watchdog, when the robot process is frozen or gone."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

from iher_robot.host.persistence import RobotMemory
from iher_robot.host.settings import HostSettings
from iher_robot.host.supervisor import WATCHDOG_FAULT, Host, HostFailed


class _Process:
    exitcode = -9

    def __init__(self, alive: bool) -> None:
        self.alive = alive
        self.killed = False

    def is_alive(self) -> bool:
        return self.alive

    def kill(self) -> None:
        self.killed, self.alive = True, False

    def join(self, timeout_s: float | None = None) -> None:
        del timeout_s


class _Holder:
    def __init__(self, fails: bool) -> None:
        self.calls = 0
        self.fails = fails

    def __call__(self) -> None:
        self.calls += 1
        if self.fails:
            raise OSError("the second socket is also gone")


def _host(folder: Path, holder: _Holder, robot: _Process) -> Any:
    settings = HostSettings("fetch", "mujoco", {}, ("tcp/127.0.0.1:1",), folder)
    host: Any = Host(settings, holder)
    host._robot, host._gateway = robot, _Process(alive=True)
    return host


@pytest.mark.parametrize("fails", [False, True])
def test_a_frozen_loop_is_killed_held_and_latched_even_if_the_holder_fails(
    tmp_path: Path, fails: bool
) -> None:
    holder, robot = _Holder(fails), _Process(alive=True)
    host = _host(tmp_path, holder, robot)
    host._heartbeat.set_deadline(0.0)
    time.sleep(0.01)
    with pytest.raises(HostFailed, match="clear-fault watchdog"):
        host.watch()
    assert (robot.killed, holder.calls) == (True, 1)
    fault = RobotMemory(tmp_path).fault
    assert fault is not None
    assert fault.name == WATCHDOG_FAULT


def test_a_robot_whose_process_died_is_held_from_outside(tmp_path: Path) -> None:
    holder = _Holder(fails=False)
    host = _host(tmp_path, holder, _Process(alive=False))
    with pytest.raises(HostFailed, match="the robot process of 'fetch' ended with exit code -9"):
        host.watch()
    assert holder.calls == 1
