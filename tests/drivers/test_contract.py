"""The contract of `RobotDriver`, on every driver."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from drivers import (
    EMERGENCY_STOP,
    EndEffectorCommand,
    FaultLatched,
    InvalidCommand,
    JointCommand,
    LifecycleError,
    Mode,
    Refusal,
    ResetOutcome,
    ResetRequest,
    RobotDriver,
    RobotState,
)
from drivers.mujoco import MujocoDriver
from tests.drivers.fake_robot import FakeRobot

# The speed of a tick is measured over these many: inertia takes a few.
_TICKS = 5


@pytest.fixture(params=[FakeRobot, MujocoDriver], ids=["fake", "mujoco"])
def driver(request: pytest.FixtureRequest) -> Iterator[RobotDriver]:
    made: RobotDriver = request.param()
    yield made
    made.close()


def step_towards(state: RobotState, dx: float = 0.01) -> EndEffectorCommand:
    return EndEffectorCommand(state.seq, np.array([dx, 0.0, 0.0]), np.zeros(2))


def start(driver: RobotDriver) -> RobotState:
    driver.open()
    driver.reset(ResetRequest())
    driver.arm()
    return driver.read()


@pytest.mark.parametrize(
    "call",
    [
        RobotDriver.arm,
        RobotDriver.read,
        RobotDriver.advance,
        lambda driver: driver.reset(ResetRequest()),
        lambda driver: driver.command(EndEffectorCommand(0, np.zeros(3), np.zeros(2))),
    ],
    ids=["arm", "read", "advance", "reset", "command"],
)
def test_nothing_moves_before_open(
    driver: RobotDriver, call: Callable[[RobotDriver], object]
) -> None:
    with pytest.raises(LifecycleError, match="not open"):
        call(driver)


def test_calls_out_of_order_are_errors(driver: RobotDriver) -> None:
    start(driver)
    with pytest.raises(LifecycleError, match="open already"):
        driver.open()
    with pytest.raises(LifecycleError, match="armed; disarm it first"):
        driver.arm()
    with pytest.raises(LifecycleError, match="armed; disarm it first"):
        driver.reset(ResetRequest())


def test_a_command_moves_and_is_reported_in_the_next_state(driver: RobotDriver) -> None:
    state = start(driver)
    first = state.ee_pos[0]
    for _ in range(_TICKS):
        command = step_towards(state)
        assert driver.command(command).accepted
        driver.advance()
        state = driver.read()
        assert state.mode is Mode.MOVING
        assert state.applied is not None
        assert state.applied.tick == state.seq
        assert state.applied.command.answers == state.seq - 1
        assert not state.applied.clipped
    assert state.ee_pos[0] > first + 0.01


def test_a_tick_without_a_command_is_held(driver: RobotDriver) -> None:
    state = start(driver)
    driver.command(step_towards(state))
    driver.advance()
    for _ in range(20):  # the simulated arm coasts for some ticks
        driver.advance()
    before = driver.read()
    driver.advance()
    after = driver.read()
    assert after.mode is Mode.HELD
    assert after.seq == before.seq + 1
    assert after.applied is not None
    assert after.applied.tick < after.seq
    np.testing.assert_allclose(after.ee_pos, before.ee_pos, atol=5e-5)


def test_the_last_command_of_a_tick_counts(driver: RobotDriver) -> None:
    state = start(driver)
    last = step_towards(state, dx=-0.02)
    driver.command(step_towards(state))
    driver.command(last)
    driver.advance()
    applied = driver.read().applied
    assert applied is not None
    assert isinstance(applied.command, EndEffectorCommand)
    np.testing.assert_array_equal(applied.command.delta_pos, last.delta_pos)


def test_disarming_drops_what_was_accepted_and_refuses_more(driver: RobotDriver) -> None:
    state = start(driver)
    driver.command(step_towards(state))
    driver.disarm()
    driver.disarm()
    driver.advance()
    after = driver.read()
    assert after.applied is None
    assert after.mode is Mode.DISARMED
    refused = driver.command(step_towards(after))
    assert refused.refusal is Refusal.DISARMED
    assert driver.refusals == {Refusal.DISARMED: 1}


def test_a_command_expires_by_the_age_of_the_state_it_answers(driver: RobotDriver) -> None:
    old = start(driver)
    allowed = int(driver.spec.limits.watchdog_s / driver.spec.control_period_s)
    for _ in range(allowed):
        driver.advance()
        driver.read()
    assert driver.command(step_towards(old)).accepted
    driver.advance()
    new = driver.read()
    refused = driver.command(step_towards(old))
    assert refused.refusal is Refusal.EXPIRED
    assert f"allowed: {driver.spec.limits.watchdog_s} s" in refused.message
    assert driver.command(step_towards(new)).accepted


def test_states_from_before_a_reset_and_from_the_future_cannot_be_answered(
    driver: RobotDriver,
) -> None:
    old = start(driver)
    driver.disarm()
    assert driver.reset(ResetRequest()).outcome is ResetOutcome.DONE
    driver.arm()
    new = driver.read()
    assert new.seq > old.seq
    assert driver.command(step_towards(old)).refusal is Refusal.UNKNOWN_STATE
    ahead = EndEffectorCommand(new.seq + 1, np.zeros(3), np.zeros(2))
    assert driver.command(ahead).refusal is Refusal.UNKNOWN_STATE


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (EndEffectorCommand(0, np.zeros(2), np.zeros(2)), r"delta_pos has shape \(2,\)"),
        (EndEffectorCommand(0, np.zeros(3), np.zeros(3)), r"finger_delta has shape \(3,\)"),
        (EndEffectorCommand(0, np.array([0, np.nan, 0]), np.zeros(2)), "delta_pos is .*finite"),
        (EndEffectorCommand(0, np.zeros(3), np.array([np.inf, 0])), "finger_delta is .*finite"),
        (JointCommand(0, np.zeros(1), np.zeros(1), 0.04, np.zeros(2)), "allowed: ee_delta"),
        (EndEffectorCommand(1.0, np.zeros(3), np.zeros(2)), r"answers is 1\.0, .* int"),  # type: ignore[arg-type]
        (EndEffectorCommand(True, np.zeros(3), np.zeros(2)), "answers is True"),
        (EndEffectorCommand(None, np.zeros(3), np.zeros(2)), "answers is None"),  # type: ignore[arg-type]
        (EndEffectorCommand([1], np.zeros(3), np.zeros(2)), r"answers is \[1\]"),  # type: ignore[arg-type]
    ],
    ids=[
        "position shape",
        "finger shape",
        "nan",
        "infinity",
        "kind",
        "fraction",
        "truth",
        "nothing",
        "unhashable",
    ],
)
def test_a_command_that_cannot_be_carried_out_is_an_error(
    driver: RobotDriver, command: EndEffectorCommand | JointCommand, message: str
) -> None:
    start(driver)
    with pytest.raises(InvalidCommand, match=message):
        driver.command(command)
    assert driver.refusals == {}


def test_stop_latches_until_it_is_cleared_by_name(driver: RobotDriver) -> None:
    state = start(driver)
    driver.command(step_towards(state))
    driver.stop("someone walked in")
    driver.stop("a later reason")
    assert driver.fault is not None
    assert driver.fault.reason == "someone walked in"
    driver.advance()
    stopped = driver.read()
    assert (stopped.mode, stopped.fault) == (Mode.STOPPED, EMERGENCY_STOP)
    assert stopped.applied is None
    assert driver.command(step_towards(stopped)).refusal is Refusal.LATCHED
    for moving in (driver.arm, lambda: driver.reset(ResetRequest())):
        with pytest.raises(FaultLatched, match="someone walked in"):
            moving()
    with pytest.raises(LifecycleError, match="latched: 'emergency_stop'"):
        driver.clear_fault("overheated")
    driver.clear_fault(EMERGENCY_STOP)
    assert not driver.is_armed
    assert driver.fault is None
    with pytest.raises(LifecycleError, match="latched: None"):
        driver.clear_fault(EMERGENCY_STOP)
    driver.arm()
    assert driver.command(step_towards(driver.read())).accepted


def test_a_latched_stop_survives_a_restart(driver: RobotDriver) -> None:
    driver.stop("pressed before the robot was even opened")
    driver.open()
    driver.close()
    driver.open()
    with pytest.raises(FaultLatched, match="pressed before"):
        driver.arm()


def test_close_is_idempotent_and_the_driver_opens_again(driver: RobotDriver) -> None:
    driver.close()
    start(driver)
    driver.close()
    driver.close()
    assert not driver.is_open
    assert not driver.is_armed
    assert start(driver).mode is Mode.HELD


def test_a_context_ends_held_and_disarmed_when_its_body_raises(driver: RobotDriver) -> None:
    def episode() -> None:
        with driver:
            driver.reset(ResetRequest())
            driver.arm()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        episode()
    assert not driver.is_armed
    assert not driver.is_open


def test_states_cannot_be_written_to(driver: RobotDriver) -> None:
    state = start(driver)
    with pytest.raises(ValueError, match="read-only"):
        state.ee_pos[0] = 0.0
    with pytest.raises(ValueError, match="read-only"):
        state.objects["object0"].pos[0] = 0.0


def test_the_tick_counter_never_falls(driver: RobotDriver) -> None:
    seen = [start(driver).seq]
    driver.advance()
    seen.append(driver.read().seq)
    driver.disarm()
    driver.reset(ResetRequest())
    seen.append(driver.read().seq)
    driver.close()
    driver.open()
    seen.append(driver.read().seq)
    assert seen == sorted(seen)
