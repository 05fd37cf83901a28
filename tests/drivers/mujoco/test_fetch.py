"""The parameters of a simulated Fetch robot, and the effect of each."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from drivers import (
    InvalidRequest,
    InvalidSpec,
    JointCommand,
    Kinematics,
    ResetRequest,
    RobotState,
    make_driver,
)
from drivers.mujoco import FetchRobot, MujocoDriver
from drivers.mujoco.robot import fetch_robot
from tests.repository import ROOT

ROBOTS = ROOT / "configs" / "robots"
PERIOD_NS = 40_000_000
Options = dict[str, object]


def options_of(name: str) -> Options:
    options = yaml.safe_load((ROBOTS / f"{name}.yaml").read_text())
    assert isinstance(options, dict)
    return options


def started(scene: str = "push", seed: int = 0, **options: object) -> MujocoDriver:
    driver = MujocoDriver(scene, fetch_robot(options))
    driver.open()
    places = {} if scene == "reach" else {"object0": (1.34, 0.6)}
    driver.reset(ResetRequest(places, seed=seed))
    driver.arm()
    return driver


def tick(driver: MujocoDriver, dq: list[float]) -> RobotState:
    state = driver.read()
    now = state.setpoint
    assert now is not None
    velocity = np.array(dq)
    q_target = now.q + (now.dq + velocity) / 2 * 0.04
    driver.command(JointCommand(state.seq, q_target, velocity, 0.04, now.fingers))
    driver.advance()
    return driver.read()


TURN = [0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
STILL = [0.0] * 8


def test_the_shipped_robot_is_the_default_and_says_all_of_it() -> None:
    assert fetch_robot(options_of("fetch")) == FetchRobot()
    written = FetchRobot().model_dump()
    assert options_of("fetch").keys() == written.keys()
    for section in ("arm", "gripper", "object", "sensors"):
        assert options_of("fetch")[section].keys() == written[section].keys()  # type: ignore[attr-defined]


def test_the_worn_robot_differs_in_everything_physical() -> None:
    worn, new = fetch_robot(options_of("fetch-worn")).model_dump(), FetchRobot().model_dump()
    for section in ("arm", "gripper", "object", "sensors"):
        for name, value in new[section].items():
            assert worn[section][name] != value, f"{section}.{name}"
    assert worn["actuation"] == "joint"
    assert fetch_robot(options_of("fetch-mocap")).actuation == "mocap"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"actuation": "mocup"}, "robot setting actuation is 'mocup': input should be 'joint' or"),
        ({"arms": {}}, "unknown robot setting 'arms', valid: .*; did you mean 'arm'"),
        (
            {"arm": {"kq": 1.0}},
            r"unknown robot setting 'arm\.kq', valid: .*; did you mean 'arm\.kp'",
        ),
        (
            {"arm": {"kp": -1.0}},
            r"robot setting arm\.kp is -1\.0: .* greater than or equal to 1000",
        ),
        ({"arm": {"kp": float("nan")}}, r"robot setting arm\.kp is nan"),
        ({"arm": {"delay_ticks": 1.5}}, r"arm\.delay_ticks is 1\.5"),
        ({"object": {"mass_scale": "heavy"}}, r"object\.mass_scale is 'heavy'"),
        (
            {"sensors": 3},
            "robot setting sensors is 3, allowed: a section with the keys joint_noise,",
        ),
        ({"sensors": {"object_rate_hz": 0.0}}, r"sensors\.object_rate_hz is 0\.0"),
    ],
)
def test_invalid_settings_are_refused_in_a_sentence(options: Options, message: str) -> None:
    with pytest.raises(InvalidSpec, match=message):
        make_driver("mujoco", scene="push", **options)


def test_the_body_tells_robots_apart_and_the_interface_does_not() -> None:
    new, soft = MujocoDriver("push"), MujocoDriver("push", fetch_robot({"arm": {"kp": 2e4}}))
    assert new.spec.interface_digest == soft.spec.interface_digest
    assert new.spec.body_digest != soft.spec.body_digest
    assert "gains.arm_kp: 100000.0, not 20000.0" in new.spec.body_differences(soft.spec)
    # Unknowns of a real robot are in neither digest.
    heavy = MujocoDriver("push", fetch_robot({"object": {"mass_scale": 3.0}}))
    assert heavy.spec.body_digest == new.spec.body_digest
    assert heavy.spec.interface_digest == new.spec.interface_digest


@pytest.mark.parametrize("actuation", ["joint", "mocap"])
def test_mass_and_friction_scale(actuation: str) -> None:
    def model(**scales: float) -> tuple[float, NDArray[np.float64], float]:
        driver = started(actuation=actuation, object=scales)
        made = driver.snapshot().model
        body, geom = made.body("object0"), made.geom("object0")
        return float(body.mass[0]), body.inertia.copy(), float(geom.friction[0])

    mass, inertia, friction = model()
    assert (mass, friction) == (2.0, 1.0)
    heavy = model(mass_scale=3.0, friction_scale=0.5)
    assert heavy[0] == pytest.approx(6.0)
    np.testing.assert_allclose(heavy[1], 3 * inertia)
    assert heavy[2] == pytest.approx(0.5)


def slid_m(friction_scale: float) -> float:
    driver = started(object={"friction_scale": friction_scale})
    data = driver.snapshot()
    address = data.model.joint("object0:joint").dofadr[0]
    data.qvel[address] = 0.5  # a kick
    driver.restore(data)
    before = driver.read().objects["object0"].pos
    for _ in range(20):
        driver.advance()
    return float(np.linalg.norm(driver.read().objects["object0"].pos - before))


def test_an_object_on_a_smoother_table_slides_further() -> None:
    assert slid_m(0.3) > 1.5 * slid_m(1.0) > 0.0


def test_softer_and_later_motors_lag() -> None:
    def lag(**arm: float) -> float:
        driver = started("reach", arm=arm)
        for _ in range(5):
            state = tick(driver, TURN)
        assert state.setpoint is not None
        return float(np.abs(state.setpoint.q - state.q).max())

    new, soft, late = lag(), lag(kp=3e3), lag(delay_ticks=2)
    assert new < 1e-3
    assert soft > 1.5 * new
    assert late == pytest.approx(2 * 0.04 * TURN[1], rel=0.1)


def test_a_delay_is_a_delay_and_nothing_else() -> None:
    tracks = []
    for delay in (0, 2):
        driver = started("reach", arm={"delay_ticks": delay})
        commands = [TURN] * 5 + [STILL] * 7
        tracks.append([tick(driver, dq).q for dq in commands])
    np.testing.assert_allclose(tracks[1][2:], tracks[0][:-2], atol=1e-7)


def test_slower_motors_take_longer_to_reach_a_speed() -> None:
    driver = started("reach", arm={"acceleration_scale": 0.25})
    state = tick(driver, [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert state.setpoint is not None
    assert state.setpoint.dq[1] == pytest.approx(0.25 * 11.0 * 0.04)
    assert state.applied is not None
    assert state.applied.clipped == ("joint_acceleration",)


def test_noise_has_its_deviation_and_follows_from_the_seed_of_the_reset() -> None:
    noise = {"joint_noise": 0.01, "joint_velocity_noise": 0.1, "object_noise_m": 0.005}
    readings = []
    for seed in (1, 1, 2):
        driver = started(seed=seed, sensors=noise | {"object_turn_noise": 0.02})
        states = []
        for _ in range(200):
            driver.advance()
            states.append(driver.read())
        rows = [np.concatenate([s.q, s.dq, s.objects["object0"].pos]) for s in states]
        readings.append(np.array(rows))
        assert driver.read() is driver.read(), "a measurement does not change when it is read again"
    np.testing.assert_array_equal(readings[0], readings[1])
    assert (readings[0] != readings[2]).any()
    deviation = readings[0].std(axis=0)
    np.testing.assert_allclose(deviation[:8], 0.01, rtol=0.2)
    np.testing.assert_allclose(deviation[8:16], 0.1, rtol=0.2)
    np.testing.assert_allclose(deviation[16:], 0.005, rtol=0.2)


def test_a_noisy_arm_is_where_its_noisy_joints_say() -> None:
    driver = started("reach", sensors={"joint_noise": 0.002})
    kinematics = Kinematics(driver.spec)
    for _ in range(10):
        driver.advance()
        state = driver.read()
        np.testing.assert_allclose(kinematics.ee_pos(state.q), state.ee_pos, atol=1e-4)


def test_the_camera_has_its_own_rate_and_delay() -> None:
    driver = started(sensors={"object_rate_hz": 15.0, "object_delay_s": 0.03})
    data = driver.snapshot()
    address = data.model.joint("object0:joint").dofadr[0]
    data.qvel[address] = 0.3
    driver.restore(data)
    start_ns = driver.read().stamp_ns
    stamps, ages = [], []
    for _ in range(50):
        driver.advance()
        state = driver.read()
        pose = state.objects["object0"]
        stamps.append(pose.stamp_ns - start_ns)
        ages.append(state.stamp_ns - pose.stamp_ns)
    assert len(set(stamps)) == pytest.approx(15 * 50 * 0.04, abs=2)
    assert min(ages[5:]) >= 30_000_000
    limit_s = driver.spec.objects["object0"].max_age_s
    assert max(ages) <= limit_s * 1e9
    assert max(ages) > PERIOD_NS, "a 15 Hz camera is not stale at 25 Hz"


def test_without_rate_and_delay_the_camera_measures_in_every_tick() -> None:
    driver = started()
    for _ in range(5):
        driver.advance()
        state = driver.read()
        assert state.objects["object0"].stamp_ns == state.stamp_ns


def test_a_snapshot_of_motors_in_motion_continues_to_the_bit() -> None:
    driver = started("push", arm={"delay_ticks": 1})
    for _ in range(4):
        tick(driver, TURN)
    snapshot = driver.snapshot()
    first = [tick(driver, TURN) for _ in range(5)]
    driver.restore(snapshot)
    second = [tick(driver, TURN) for _ in range(5)]
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.q, other.q)
        np.testing.assert_array_equal(one.dq, other.dq)


def test_a_simulation_without_setpoints_is_held_where_it_is() -> None:
    driver = started("push")
    foreign = mujoco.MjData(driver.snapshot().model)
    foreign.qpos[:] = driver.snapshot().qpos
    mujoco.mj_forward(foreign.model, foreign)
    before = driver.read()
    driver.restore(foreign)
    driver.advance()
    np.testing.assert_allclose(driver.read().q, before.q, atol=1e-4)


def test_a_simulation_whose_joints_were_moved_is_held_where_they_are() -> None:
    driver = started("reach")
    moved = driver.snapshot()
    moved.qpos[moved.model.joint("robot0:shoulder_pan_joint").qposadr[0]] += 0.6
    driver.restore(moved)
    before = driver.read()
    driver.advance()
    np.testing.assert_allclose(driver.read().q, before.q, atol=1e-3)
    moved.userdata[:] = np.nan
    driver.restore(moved)
    driver.advance()
    np.testing.assert_allclose(driver.read().q, before.q, atol=1e-3)


def test_a_simulation_of_motors_with_another_delay_is_not_restored() -> None:
    with pytest.raises(InvalidRequest, match="nuserdata is"):
        started("reach").restore(started("reach", arm={"delay_ticks": 2}).snapshot())


def test_fingers_are_guarded_where_they_are_when_open() -> None:
    driver = started("pick_and_place")
    kinematics = Kinematics(driver.spec)
    points = kinematics.guarded_points(np.array(driver.spec.home.q))[1:]
    tips = points[kinematics.guard_radii < 1e-3]
    data = driver.snapshot()
    for finger in ("robot0:r_gripper_finger_joint", "robot0:l_gripper_finger_joint"):
        data.qpos[data.model.joint(finger).qposadr[0]] = 0.05
    mujoco.mj_kinematics(data.model, data)
    for finger in ("robot0:r_gripper_finger_link", "robot0:l_gripper_finger_link"):
        geom = data.geom(finger)
        corners = np.array(np.meshgrid([0.0385], [-0.007, 0.007], [-0.0135, 0.0135])).T.reshape(
            -1, 3
        )
        outer = corners @ geom.xmat.reshape(3, 3).T + geom.xpos
        nearest = np.linalg.norm(outer[:, None] - tips[None], axis=-1).min(axis=1)
        assert nearest.max() < 0.02, "two corners are guarded, the others are a finger's width away"
        assert np.sort(nearest)[1] < 1e-3


def test_home_is_off_the_table_where_the_reference_presses_on_it() -> None:
    for scene in ("push", "slide"):
        motors = MujocoDriver(scene).spec.home
        dragged = MujocoDriver(scene, FetchRobot(actuation="mocap")).spec.home
        assert 0.0 < motors.ee_pos[2] - dragged.ee_pos[2] < 0.02
        np.testing.assert_allclose(motors.ee_pos[:2], dragged.ee_pos[:2], atol=0.03)


@pytest.mark.parametrize("scene", ["reach", "push", "pick_and_place", "slide"])
def test_a_robot_at_home_stays_there(scene: str) -> None:
    driver = MujocoDriver(scene)
    with driver:
        driver.reset(ResetRequest())
        driver.arm()
        before = driver.read()
        for _ in range(50):
            driver.advance()
        after = driver.read()
    np.testing.assert_allclose(after.ee_pos, before.ee_pos, atol=1e-5)
    np.testing.assert_allclose(before.ee_pos, driver.spec.home.ee_pos, atol=1e-6)
