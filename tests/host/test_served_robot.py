"""A served robot: a stop while the scene changes, poses, and human help over a restart."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from drivers import (
    HandsNotClear,
    InvalidRequest,
    ResetOutcome,
    ResetRequest,
    ResetResult,
    SimulatedClock,
)
from drivers.remote.messages import ObjectMessage
from iher_robot.host.persistence import RobotMemory
from iher_robot.host.served_robot import ServedRobot
from tests.drivers.fake_robot import FakeRobot


class SlowToClose(FakeRobot):
    def __init__(self) -> None:
        super().__init__()
        self.closing, self.may_close = threading.Event(), threading.Event()

    def _close(self) -> None:
        self.closing.set()
        assert self.may_close.wait(10.0)
        super()._close()


def test_a_stop_while_the_scene_changes_stops_the_robot_of_the_new_one(tmp_path: Path) -> None:
    memory, first = RobotMemory(tmp_path), SlowToClose()
    drivers = [first, FakeRobot()]
    robot = ServedRobot(lambda _: drivers.pop(0), "push", memory, (), SimulatedClock())
    robot._specs["slide"] = robot.spec
    robot.open()
    changing = threading.Thread(target=robot.change_scene, args=("slide",))
    changing.start()
    assert first.closing.wait(10.0)
    stopping = threading.Thread(target=robot.stop, args=("someone walked in", "emergency_stop"))
    stopping.start()
    first.may_close.set()
    changing.join(10.0)
    stopping.join(10.0)
    assert robot.driver is not first
    assert robot.driver.fault is not None
    assert robot.driver.fault.reason == "someone walked in"
    assert RobotMemory(tmp_path).fault is not None, "and it outlives the host"


def test_a_pose_of_an_object_that_is_not_in_the_scene_is_refused(tmp_path: Path) -> None:
    robot = ServedRobot(
        lambda _: FakeRobot(), "push", RobotMemory(tmp_path), ("object0",), SimulatedClock()
    )
    robot.spec = robot.spec.__class__(**{**vars(robot.spec), "objects": {}})
    pose = ObjectMessage(
        n=1,
        age_s=0.0,
        frame="world",
        pos=np.zeros(3),
        quat=np.array([1.0, 0.0, 0.0, 0.0]),
        linvel=np.zeros(3),
        angvel=np.zeros(3),
    )
    with pytest.raises(
        InvalidRequest, match="'object0', which is not one of perception, allowed: none"
    ):
        robot.take_pose("object0", pose)


class Helpless(FakeRobot):
    """Needs a human at every reset at full speed."""

    def _reset(self, request: ResetRequest) -> ResetResult:
        if self.speed_scale == 1.0:
            return ResetResult(ResetOutcome.NEEDS_HUMAN, "put the cube back")
        return super()._reset(request)


def test_a_restart_of_the_host_keeps_that_a_human_was_needed(tmp_path: Path) -> None:
    for attempt in range(2):
        robot = ServedRobot(
            lambda _: Helpless(), "push", RobotMemory(tmp_path), (), SimulatedClock()
        )
        robot.open()
        if attempt == 0:
            assert robot.reset(ResetRequest()).outcome is ResetOutcome.NEEDS_HUMAN
        else:
            with pytest.raises(HandsNotClear):
                robot.driver.arm()
            with pytest.raises(HandsNotClear):
                robot.reset(ResetRequest())
            robot.driver.confirm_hands_clear()
            assert robot.reset(ResetRequest()).outcome is ResetOutcome.DONE
        robot.close()
    assert not RobotMemory(tmp_path).human_needed
