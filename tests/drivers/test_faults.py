"""The driver contract when hooks fail, threads race, and a human has to help."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable

import numpy as np
import pytest

from drivers import (
    EndEffectorCommand,
    HandsNotClear,
    InvalidCommand,
    InvalidRequest,
    JointCommand,
    LifecycleError,
    Refusal,
    ResetOutcome,
    ResetRequest,
    StaleState,
)
from tests.drivers.fake_robot import PERIOD_NS, FakeRobot


@pytest.fixture
def robot() -> FakeRobot:
    return FakeRobot()


def arm(robot: FakeRobot) -> None:
    robot.open()
    robot.reset(ResetRequest())
    robot.arm()


def test_a_stop_from_another_thread_does_not_wait_for_the_tick(robot: FakeRobot) -> None:
    arm(robot)
    robot.slow = True
    ticking = threading.Thread(target=robot.advance)
    ticking.start()
    assert robot.waiting.wait(timeout=10.0)
    stopping = threading.Thread(target=robot.stop, args=("pressed",))
    stopping.start()
    while robot.fault is None:
        assert ticking.is_alive()
    assert not robot.is_armed, "the gate must be closed while the tick still runs"
    robot.released.set()
    ticking.join(timeout=10.0)
    stopping.join(timeout=10.0)
    assert robot.calls[-1] == "hold"


def test_a_command_accepted_before_a_stop_is_not_applied_after_it(robot: FakeRobot) -> None:
    arm(robot)
    state = robot.read()
    robot.command(EndEffectorCommand(state.seq, np.ones(3) * 0.01, np.zeros(2)))
    robot._gate.latch("overheated", "latched, and its hold still waits for the lock")
    robot.advance()
    assert robot.applied is None
    np.testing.assert_array_equal(robot.position, state.ee_pos)


def test_stops_closes_and_disarms_from_many_threads_end_disarmed(robot: FakeRobot) -> None:
    arm(robot)
    calls = [lambda: robot.stop("pressed"), robot.disarm, robot.close] * 5
    threads = [threading.Thread(target=call) for call in calls]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=10.0)
    assert not robot.is_armed
    assert not robot.is_open
    assert robot.calls.count("close") == 1
    assert robot.fault is not None


@pytest.mark.parametrize("hook", ["hold", "advance", "read", "reset", "apply"])
def test_a_context_ends_disarmed_and_disconnected_when_a_hook_raises(
    robot: FakeRobot, hook: str
) -> None:
    def episode() -> None:
        with robot:
            robot.reset(ResetRequest())
            robot.arm()
            state = robot.read()
            robot.command(EndEffectorCommand(state.seq, np.zeros(3), np.zeros(2)))
            robot.advance()

    robot.failing = {hook}
    with pytest.raises(OSError, match=f"{hook} failed"):
        episode()
    assert not robot.is_armed
    assert not robot.is_open
    assert robot.calls[-2:] == ["hold", "close"]


def test_an_old_measurement_is_stale(robot: FakeRobot) -> None:
    robot.open()
    robot.clock.advance_ns(2 * PERIOD_NS)
    assert robot.read().seq == 0
    with pytest.raises(StaleState, match=r"state of fake is 0\.080 s old, allowed: 0\.05 s"):
        robot.read(max_age_s=0.05)
    robot.clock.advance_ns(PERIOD_NS)
    with pytest.raises(StaleState, match=r"allowed: 0\.1 s"):
        robot.read()


def test_each_sensor_has_its_own_age_limit(robot: FakeRobot) -> None:
    robot.open()
    robot.clock.advance_ns(PERIOD_NS)
    robot.advance()
    robot.camera_age_ns = 150_000_000  # older than the robot's limit, within the camera's
    assert robot.read().objects["object0"].stamp_ns < robot.stamp_ns
    robot.camera_age_ns = 201_000_000
    with pytest.raises(StaleState, match=r"object 'object0' of fake is 0\.201 s old"):
        robot.read()


def test_a_stale_state_cannot_be_answered(robot: FakeRobot) -> None:
    arm(robot)
    robot.clock.advance_ns(4 * PERIOD_NS)
    with pytest.raises(StaleState):
        robot.read()
    command = EndEffectorCommand(robot.seq, np.zeros(3), np.zeros(2))
    assert not robot.command(command).accepted


def test_after_human_help_hands_are_confirmed_clear_before_anything_moves(
    robot: FakeRobot,
) -> None:
    robot.open()
    with pytest.raises(LifecycleError, match="nothing to confirm"):
        robot.confirm_hands_clear()
    robot.outcomes = [ResetOutcome.NEEDS_HUMAN]
    assert robot.reset(ResetRequest()).outcome is ResetOutcome.NEEDS_HUMAN
    for moving in (robot.arm, lambda: robot.reset(ResetRequest())):
        with pytest.raises(HandsNotClear, match="confirm_hands_clear"):
            moving()
    assert robot.speed_scale == 1.0
    robot.confirm_hands_clear()
    assert robot.speed_scale == 0.25
    robot.outcomes = [ResetOutcome.FAILED]
    robot.reset(ResetRequest())
    assert robot.speed_scale == 0.25, "a failed reset must not restore full speed"
    robot.reset(ResetRequest())
    assert robot.speed_scale == 1.0
    robot.arm()
    assert robot.is_armed


def test_hands_stay_unconfirmed_over_a_restart(robot: FakeRobot) -> None:
    robot.open()
    robot.outcomes = [ResetOutcome.NEEDS_HUMAN]
    robot.reset(ResetRequest())
    robot.close()
    robot.open()
    with pytest.raises(HandsNotClear):
        robot.arm()


@pytest.mark.parametrize("connect", [FakeRobot.open, FakeRobot.__enter__], ids=["open", "with"])
@pytest.mark.parametrize("cleanup", [(), ("hold",), ("close",), ("hold", "close")], ids=str)
def test_an_open_that_fails_leaves_nothing_connected(
    robot: FakeRobot, connect: Callable[[FakeRobot], object], cleanup: tuple[str, ...]
) -> None:
    robot.failing = {"open", *cleanup}
    with pytest.raises(OSError, match="open failed") as caught:
        connect(robot)
    assert robot.calls == ["open", "hold", "close"]
    assert not robot.is_open
    notes = " ".join(getattr(caught.value, "__notes__", []))
    assert all(f"{hook} failed" in notes for hook in cleanup)
    robot.failing = set()
    arm(robot)
    assert robot.is_armed


def test_an_interrupted_open_is_undone_too(
    robot: FakeRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(robot, "_open", interrupted)
    with pytest.raises(KeyboardInterrupt):
        robot.open()
    assert robot.calls == ["hold", "close"]


def test_a_stop_holds_when_the_interruption_fails(
    robot: FakeRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing() -> None:
        raise OSError("no way to interrupt")

    arm(robot)
    monkeypatch.setattr(robot, "_interrupt", failing)
    with pytest.raises(OSError, match="no way to interrupt"):
        robot.stop("pressed")
    assert robot.calls[-1] == "hold"
    assert robot.fault is not None
    assert not robot.is_armed


@pytest.mark.parametrize("age_s", [math.nan, -0.001, -math.inf])
def test_an_age_limit_that_limits_nothing_is_an_error(robot: FakeRobot, age_s: float) -> None:
    robot.open()
    robot.clock.advance_ns(100 * PERIOD_NS)
    with pytest.raises(InvalidRequest, match=r"max_age_s of read on fake is .*, allowed: 0 s"):
        robot.read(max_age_s=age_s)


def test_a_refusal_gives_the_age_and_the_limit(robot: FakeRobot) -> None:
    arm(robot)
    command = EndEffectorCommand(robot.read().seq, np.zeros(3), np.zeros(2))
    robot.clock.advance_ns(3 * PERIOD_NS)
    message = robot.command(command).message
    assert message == f"answers state {command.answers}, 0.120 s old, allowed: 0.1 s"


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (EndEffectorCommand(0, np.zeros(2), np.zeros(2)), r"delta_pos has shape \(2,\), .* \(3,\)"),
        (EndEffectorCommand(0, np.array([0, np.nan, 0]), np.zeros(2)), "delta_pos is .*finite"),
        (EndEffectorCommand(True, np.zeros(3), np.zeros(2)), "answers is True, .* int"),
        (JointCommand(0, np.zeros(1), np.zeros(1), 0.04, np.zeros(2)), "allowed: ee_delta"),
    ],
    ids=["shape", "nan", "answers", "kind"],
)
def test_an_error_says_what_is_wrong_with_a_command(
    robot: FakeRobot, command: EndEffectorCommand | JointCommand, message: str
) -> None:
    arm(robot)
    with pytest.raises(InvalidCommand, match=message):
        robot.command(command)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_while_a_measurement_is_not_finite_nothing_moves(robot: FakeRobot, bad: float) -> None:
    arm(robot)
    state = robot.read()
    robot.position = np.array([bad, 0.5, 0.5])
    answer = robot.command(EndEffectorCommand(state.seq, np.ones(3) * 0.01, np.zeros(2)))
    assert answer.refusal is Refusal.BAD_MEASUREMENT
    assert "not finite" in answer.message
    assert robot.refusals == {Refusal.BAD_MEASUREMENT: 1}
    robot.advance()
    assert robot.applied is None


class SlowToArm(FakeRobot):
    def __init__(self) -> None:
        super().__init__()
        self.arming, self.may_arm = threading.Event(), threading.Event()

    def _prepare_to_arm(self) -> None:
        self.arming.set()
        assert self.may_arm.wait(10.0)


@pytest.mark.parametrize("call", ["disarm", "close"])
def test_an_arm_in_progress_does_not_outlive_a_disarm(call: str) -> None:
    robot = SlowToArm()
    robot.open()
    arming = threading.Thread(target=robot.arm)
    arming.start()
    assert robot.arming.wait(10.0)
    ending = threading.Thread(target=getattr(robot, call))
    ending.start()
    robot.may_arm.set()
    arming.join(10.0)
    ending.join(10.0)
    assert not robot.is_armed
