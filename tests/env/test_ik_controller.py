"""Inverse kinematics controller on a simulated robot with joint motors."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers import AppliedCommand, JointCommand, JointSetpoint, Kinematics, RobotState
from drivers.mujoco import FetchRobot, MujocoDriver
from iher_robot.env.controller import EndEffectorController, make_controller
from iher_robot.env.goal_env import EpisodeAborted, GoalRobotEnv, make_env
from iher_robot.env.ik_controller import JointController
from iher_robot.errors import NoSolution
from tasks import make_task

Array = NDArray[np.float64]
EPISODES = 100
SPEED = 0.033 / 0.04


@pytest.fixture(scope="module")
def env() -> Iterator[GoalRobotEnv]:
    with make_env("reach") as made:
        yield made


def setpoint(state: RobotState) -> JointSetpoint:
    assert state.setpoint is not None
    return state.setpoint


def speeds(env: GoalRobotEnv) -> Array:
    return np.array([joint.max_velocity for joint in env.robot_spec.limits.joints.values()])


def test_the_arm_follows_what_was_commanded_over_random_episodes(env: GoalRobotEnv) -> None:
    kinematics, rng = Kinematics(env.robot_spec), np.random.default_rng(0)
    errors_m: list[float] = []
    for seed in range(EPISODES):
        env.reset(seed=seed)
        action = np.zeros(4)
        for _ in range(50):
            # Every other episode of independent noise, and of noise that persists.
            keep = 0.8 if seed % 2 else 0.0
            action = np.clip(keep * action + rng.uniform(-1, 1, 4) * (1 - keep / 2), -1, 1)
            info = env.step(action)[4]
            state = env.driver.read()
            assert info["tick_valid"]
            assert (np.abs(setpoint(state).dq) <= speeds(env) * (1 + 1e-9)).all()
            commanded = kinematics.ee_pos(setpoint(state).q)
            errors_m.append(float(np.linalg.norm(state.ee_pos - commanded)))
    assert np.percentile(errors_m, 50) <= 0.002
    assert np.percentile(errors_m, 99) <= 0.005


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_an_action_is_a_velocity_of_the_gripper(env: GoalRobotEnv, axis: int, sign: float) -> None:
    env.reset(seed=0)
    before = env.driver.read()
    action = np.zeros(4)
    action[axis] = 0.5 * sign  # at full speed some joints are at their limits
    for _ in range(5):
        env.step(action)
    state = env.driver.read()
    np.testing.assert_allclose(state.ee_linvel, SPEED * action[:3], atol=0.08 * SPEED)
    turn = np.abs(before.ee_quat @ state.ee_quat)
    assert turn > np.cos(np.radians(5) / 2), "the gripper keeps pointing down"


def test_a_zero_action_holds_still(env: GoalRobotEnv) -> None:
    env.reset(seed=0)
    before = env.driver.read()
    for _ in range(50):
        env.step(np.zeros(4))
    np.testing.assert_allclose(env.driver.read().ee_pos, before.ee_pos, atol=5e-4)


def test_it_starts_from_the_reported_setpoint_and_is_stateless() -> None:
    spec = MujocoDriver("reach").spec
    action = np.array([0.5, -0.3, 0.2, 0.0])
    driver = MujocoDriver("reach")
    with driver:
        driver.arm()
        states = []
        controller = JointController(spec, blocks_gripper=True)
        for _ in range(4):
            states.append(driver.read())
            driver.command(controller.command(action, states[-1]))
            driver.advance()
    for state in reversed(states):  # in any order, and by another one: the same commands
        again = JointController(spec, blocks_gripper=True).command(action, state)
        first = controller.command(action, state)
        np.testing.assert_array_equal(again.q_target, first.q_target)
        assert first.answers == state.seq
        now = setpoint(state)
        np.testing.assert_allclose(first.q_target, now.q + (now.dq + first.dq) / 2 * 0.04)


def test_no_joint_is_commanded_above_its_speed(env: GoalRobotEnv) -> None:
    env.reset(seed=0)
    state = env.driver.read()
    far = np.array([100.0, -100.0, 100.0, 0.0])  # no env passes this on
    command = env.controller.command(far, state)
    assert isinstance(command, JointCommand)
    assert (np.abs(command.dq) <= speeds(env) * (1 + 1e-6)).all()


WAYS = [*itertools.product((-1.0, 1.0), repeat=3), (-1.0, 0.0, 0.0)]


def share_left(env: GoalRobotEnv, out: Array, ticks: int) -> float:
    """Hold an action, then go to above home for 50 ticks; return the share of the way left."""
    env.reset(seed=0)
    spec = env.robot_spec
    above = np.add(spec.home.ee_pos, (0.0, 0.0, 0.1))
    for _ in range(ticks):
        env.step(out)
    distance_m = np.linalg.norm(above - env.driver.read().ee_pos)
    for _ in range(50):
        way = above - env.driver.read().ee_pos
        env.step(np.append(way / spec.action.position_scale_m, 0.0))
    return float(np.linalg.norm(above - env.driver.read().ee_pos) / distance_m)


@pytest.mark.parametrize("task", ["reach", "push"])
def test_the_arm_returns_from_wherever_an_action_takes_it(task: str) -> None:
    rng = np.random.default_rng(0)
    with make_env(task) as made:
        corners = {way: share_left(made, np.append(way, 0.0), 50) for way in WAYS}
        drawn = [share_left(made, rng.uniform(-1, 1, 4), 25) for _ in range(20)]
    assert {way: left for way, left in corners.items() if left > 0.05} == {}
    assert max(drawn) < 0.05


def test_a_setpoint_outside_a_limit_is_not_followed(env: GoalRobotEnv) -> None:
    env.reset(seed=0)
    state = env.driver.read()
    q = setpoint(state).q.copy()
    q[4] = 2.31  # the elbow's range ends at 2.251
    moved = dataclasses.replace(setpoint(state), q=q)
    with pytest.raises(NoSolution, match=r"elbow_flex_joint .* is at 2\.3100, allowed: -2\.251 to"):
        env.controller.command(np.zeros(4), dataclasses.replace(state, setpoint=moved))


def test_without_a_solution_the_robot_holds_and_the_abort_names_it(
    env: GoalRobotEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(*_: object) -> None:
        raise NoSolution("an arm in a knot")

    env.reset(seed=0)
    env.step(np.array([1.0, 0.0, 0.0, 0.0]))
    monkeypatch.setattr(env.controller, "command", none)
    reported = [env.step(np.zeros(4))[4] for _ in range(5)]
    assert [info["refusal"] for info in reported] == ["no_solution"] * 5
    assert not any(info["tick_valid"] for info in reported)
    assert [info["ticks"] for info in reported] == [1] * 5
    np.testing.assert_array_equal(setpoint(env.driver.read()).dq, 0.0)
    with pytest.raises(EpisodeAborted, match="6 invalid ticks, allowed: 5; an arm in a knot"):
        env.step(np.zeros(4))
    assert not env.driver.is_armed


def test_an_applied_command_converts_back_to_its_action(env: GoalRobotEnv) -> None:
    env.reset(seed=3)
    gentle = np.array([0.15, 0.1, 0.1, 0.7], dtype=np.float32)
    np.testing.assert_array_equal(env.step(gentle)[4]["action_applied"], gentle)
    hard = np.array([-1.0, 1.0, -1.0, 0.7], dtype=np.float32)
    info = env.step(hard)[4]
    assert "joint_acceleration" in info["clipped"]
    applied, state = info["action_applied"], env.driver.read()
    assert np.abs(applied[:3] - hard[:3]).max() > 0.2
    np.testing.assert_allclose(applied[:3] * SPEED, state.ee_linvel, atol=0.05)
    assert applied[3] == hard[3], "the gripper's part moves nothing in this task"


def test_fingers_move_at_their_speed_to_their_stops() -> None:
    with make_env("pick_and_place") as free:
        free.reset(seed=0)
        for tick in range(1, 31):
            info = free.step(np.array([0.0, 0.0, 0.0, 1.0]))[4]
            opened = setpoint(free.driver.read()).fingers
            np.testing.assert_allclose(opened, min(0.05, 0.002 * tick), atol=1e-9)
            assert info["clipped"] == (() if tick <= 25 else ("controller",))
        assert info["action_applied"][3] == pytest.approx(0.0, abs=1e-6), "at the stop"
        assert free.driver.read().fingers_pos.min() > 0.045


def test_against_an_obstacle_the_setpoint_stays_near_the_arm() -> None:
    driver = MujocoDriver("push")
    controller = JointController(driver.spec, blocks_gripper=True)
    kinematics = Kinematics(driver.spec)
    with driver:
        driver.arm()
        state = driver.read()
        stuck = state.ee_pos - [0.1, 0.0, 0.0]
        command = controller.command(
            np.array([1.0, 0.0, 0.0, 0.0]), dataclasses.replace(state, ee_pos=stuck)
        )
    moved = kinematics.ee_jacobian(setpoint(state).q) @ command.dq
    assert moved[0] < 0.0, "back towards the arm"


def test_the_controller_fits_the_robot() -> None:
    for actuation, kind in (("joint", JointController), ("mocap", EndEffectorController)):
        driver = MujocoDriver("push", FetchRobot.model_validate({"actuation": actuation}))
        env = GoalRobotEnv(driver, make_task("push"))
        assert isinstance(env.controller, kind)
        assert isinstance(make_controller(driver.spec, True), kind)
        assert env.controller.settings["kind"] in driver.spec.command_kinds


def test_an_applied_command_of_the_past_needs_its_start(env: GoalRobotEnv) -> None:
    env.reset(seed=0)
    state = env.driver.read()
    action = np.array([0.1, 0.0, 0.0, 0.0], dtype=np.float32)
    command = env.controller.command(action, state)
    applied = AppliedCommand(state.seq + 1, command)
    np.testing.assert_array_equal(env.controller.applied_action(action, applied, state), action)
