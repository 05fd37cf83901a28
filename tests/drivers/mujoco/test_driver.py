"""The simulated robot beyond the driver contract; parity with the reference is tested elsewhere."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from drivers import (
    EndEffectorCommand,
    InvalidRequest,
    LifecycleError,
    Mode,
    Refusal,
    ResetRequest,
    RobotState,
    UnknownDriver,
)
from drivers.mujoco import SCENES, FetchRobot, MujocoDriver

MOCAP = FetchRobot(actuation="mocap")


def tick(driver: MujocoDriver, delta_pos: list[float], fingers: float = 0.0) -> RobotState:
    seq = driver.read().seq
    command = EndEffectorCommand(seq, np.array(delta_pos), np.full(2, fingers))
    assert driver.command(command).accepted
    driver.advance()
    return driver.read()


def started(scene: str, **places: tuple[float, float]) -> MujocoDriver:
    driver = MujocoDriver(scene, MOCAP)
    driver.open()
    driver.reset(ResetRequest(places))
    driver.arm()
    return driver


def test_scenes_share_a_body_and_differ_in_their_home() -> None:
    specs = {scene: MujocoDriver(scene, MOCAP).spec for scene in SCENES}
    assert len({spec.body_digest for spec in specs.values()}) == 1
    assert len({spec.home.ee_pos for spec in specs.values()}) == len(SCENES)
    # Objects are part of the interface: Reach senses none.
    interfaces = {scene: spec.interface_digest for scene, spec in specs.items()}
    assert interfaces["push"] == interfaces["slide"] == interfaces["pick_and_place"]
    assert interfaces["push"] != interfaces["reach"]


def test_an_action_of_one_moves_about_33_mm() -> None:
    driver = started("reach")
    before = driver.read()
    for _ in range(3):
        before, after = driver.read(), tick(driver, [0.05, 0.0, 0.0])
    assert after.ee_pos[0] - before.ee_pos[0] == pytest.approx(0.033, abs=0.004)


def test_velocities_are_the_derivatives_of_positions() -> None:
    driver = started("push", object0=(1.45, 0.75))
    for _ in range(5):
        state = tick(driver, [0.05, -0.01, 0.0])
    data, moment_s = driver.snapshot(), 1e-7
    mujoco.mj_integratePos(data.model, data.qpos, data.qvel, moment_s)
    mujoco.mj_kinematics(data.model, data)
    ee_linvel = (data.site("robot0:grip").xpos - state.ee_pos) / moment_s
    np.testing.assert_allclose(state.ee_linvel, ee_linvel, atol=1e-6)
    pose = state.objects["object0"]
    linvel = (data.site("object0").xpos - pose.pos) / moment_s
    assert np.linalg.norm(linvel) > 0.1, "the gripper must have hit the object"
    np.testing.assert_allclose(pose.linvel, linvel, atol=1e-6)
    for quat, angvel, body in (
        (state.ee_quat, state.ee_angvel, "robot0:gripper_link"),
        (pose.quat, pose.angvel, "object0"),
    ):
        turned = np.zeros(3)
        back = quat * (1.0, -1.0, -1.0, -1.0)
        product = np.zeros(4)
        mujoco.mju_mulQuat(product, data.body(body).xquat, back)
        mujoco.mju_quat2Vel(turned, product, moment_s)
        np.testing.assert_allclose(angvel, turned, atol=1e-6)


def test_fingers_move_where_they_are_free_and_only_there() -> None:
    assert tick(started("pick_and_place"), [0.0, 0.0, 0.0], fingers=1.0).fingers_pos.min() > 0.005
    np.testing.assert_array_equal(tick(started("push"), [0, 0, 0], fingers=1.0).fingers_pos, 0.0)


def test_objects_start_at_the_requested_places() -> None:
    driver = started("push", object0=(1.25, 0.66))
    pose = driver.read().objects["object0"]
    np.testing.assert_allclose(pose.pos[:2], (1.25, 0.66), atol=1e-12)
    assert pose.pos[2] == pytest.approx(driver.spec.home.object_heights["object0"], abs=1e-6)


def test_unknown_objects_cannot_be_placed() -> None:
    driver = MujocoDriver("reach", MOCAP)
    driver.open()
    with pytest.raises(InvalidRequest, match=r"\['object0'\], objects of .*: \[\]"):
        driver.reset(ResetRequest({"object0": (1.3, 0.7)}))


def test_equal_resets_and_commands_give_equal_states_to_the_bit() -> None:
    driver = started("push")
    ends = []
    for _ in range(2):
        driver.disarm()
        driver.reset(ResetRequest({"object0": (1.3, 0.8)}))
        driver.arm()
        for _ in range(10):
            end = tick(driver, [0.02, 0.03, -0.01])
        ends.append(np.concatenate([end.q, end.dq, end.objects["object0"].pos]).tobytes())
    assert ends[0] == ends[1]


def test_a_restored_snapshot_continues_to_the_bit() -> None:
    driver = started("pick_and_place")
    tick(driver, [0.05, 0.0, -0.05], fingers=1.0)
    before = driver.read()
    snapshot = driver.snapshot()
    first = tick(driver, [0.0, 0.05, 0.0])
    driver.restore(snapshot)
    old = EndEffectorCommand(before.seq, np.zeros(3), np.zeros(2))
    assert driver.command(old).refusal is Refusal.UNKNOWN_STATE
    second = tick(driver, [0.0, 0.05, 0.0])
    assert first.seq < second.seq
    np.testing.assert_array_equal(first.ee_pos, second.ee_pos)
    np.testing.assert_array_equal(first.dq, second.dq)


def test_a_long_hold_does_not_drift() -> None:
    driver = started("pick_and_place")
    tick(driver, [0.02, 0.0, 0.02])
    for _ in range(25):
        driver.advance()
    settled = driver.read()
    assert settled.mode is Mode.HELD
    for _ in range(100):
        driver.advance()
    np.testing.assert_allclose(driver.read().ee_pos, settled.ee_pos, atol=2e-3)


def test_a_pause_never_makes_a_simulated_state_stale() -> None:
    driver = started("reach")
    assert driver.read(max_age_s=0.0).stamp_ns == driver.read(max_age_s=0.0).stamp_ns
    before = driver.read().stamp_ns
    driver.advance()
    assert driver.read(max_age_s=0.0).stamp_ns == before + driver.spec.control_period_ns


def test_an_unknown_scene_is_an_error() -> None:
    with pytest.raises(UnknownDriver, match="scene of driver 'mujoco': 'shove', valid: pick_and_"):
        MujocoDriver("shove")


@pytest.mark.parametrize(
    "place",
    [
        (np.nan, 0.7),
        (1.3, np.inf),
        (1.3,),
        (1.3, 0.7, 0.4),
        ((1.3, 0.7),),
        1.3,
        None,
        "table",
        ((1.3,), 0.7),
        (13.0, 0.7),
        (1.3, -0.7),
    ],
    ids=str,
)
def test_a_place_where_no_object_can_be_moves_nothing(place: tuple[float, float]) -> None:
    driver = started("push", object0=(1.25, 0.66))
    tick(driver, [0.05, 0.0, 0.0])
    driver.disarm()
    before = driver.snapshot()
    with pytest.raises(InvalidRequest, match=r"places 'object0' at .*, allowed: \(x, y\) from"):
        driver.reset(ResetRequest({"object0": place}))
    np.testing.assert_array_equal(driver.snapshot().qpos, before.qpos)
    assert driver.reset(ResetRequest({"object0": (1.3, 0.7)})).outcome == "done"


def test_nothing_is_restored_into_a_closed_robot() -> None:
    snapshot = started("push").snapshot()
    driver = MujocoDriver("push", MOCAP)
    with pytest.raises(LifecycleError, match=r"restore on fetch-mujoco-mocap-push, .*not open"):
        driver.restore(snapshot)


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        ("reach", r"nq is \d+, allowed: \d+"),
        ("pick_and_place", "nu is 2, allowed: 0"),
        ("slide", "differs, allowed: data of the same scene"),  # all sizes are equal
    ],
)
def test_a_simulation_of_another_scene_is_not_restored(scene: str, message: str) -> None:
    driver, other = started("push"), started(scene)
    before = driver.snapshot()
    with pytest.raises(InvalidRequest, match=f"data of another model: .*{message}"):
        driver.restore(other.snapshot())
    np.testing.assert_array_equal(driver.snapshot().qpos, before.qpos)
    assert driver.is_armed
    with pytest.raises(InvalidRequest, match="got a dict, allowed: MjData"):
        driver.restore({})
