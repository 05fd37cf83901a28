"""Forward kinematics from a robot's description."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from drivers import InvalidSpec, JointCommand, Kinematics, ResetRequest
from drivers.kinematics import EE_SITE
from drivers.mujoco import SCENES, MujocoDriver

SPEC = MujocoDriver("push").spec


def random_q(rng: np.random.Generator) -> np.ndarray:
    joints = SPEC.limits.joints.values()
    lower = [max(joint.lower, -np.pi) for joint in joints]
    upper = [min(joint.upper, np.pi) for joint in joints]
    return rng.uniform(lower, upper)


@pytest.mark.parametrize("scene", list(SCENES))
def test_the_description_says_where_the_simulated_gripper_is(scene: str) -> None:
    driver = MujocoDriver(scene)
    kinematics = Kinematics(driver.spec)
    with driver:
        driver.reset(ResetRequest())
        driver.arm()
        for _ in range(10):
            state = driver.read()
            np.testing.assert_allclose(kinematics.ee_pos(state.q), state.ee_pos, atol=1e-9)
            assert state.setpoint is not None
            dq = np.full(8, 0.2)
            q_target = state.setpoint.q + (state.setpoint.dq + dq) / 2 * 0.04
            fingers = state.setpoint.fingers
            driver.command(JointCommand(state.seq, q_target, dq, 0.04, fingers))
            driver.advance()
        assert np.linalg.norm(state.ee_pos - driver.spec.home.ee_pos) > 0.01


def test_the_jacobian_is_the_derivative_of_the_position() -> None:
    kinematics, rng, small = Kinematics(SPEC), np.random.default_rng(0), 1e-6
    for _ in range(20):
        q = random_q(rng)
        steps = small * np.eye(len(q))
        differences = [kinematics.ee_pos(q + d) - kinematics.ee_pos(q - d) for d in steps]
        expected = np.transpose(differences) / (2 * small)
        np.testing.assert_allclose(kinematics.ee_jacobian(q), expected, atol=1e-8)


def test_guards_come_with_the_end_effector_first() -> None:
    kinematics = Kinematics(SPEC)
    points = kinematics.guarded_points(np.array(SPEC.home.q))
    assert points.shape == (1 + len(kinematics.guard_radii), 3)
    np.testing.assert_array_equal(points[0], kinematics.ee_pos(np.array(SPEC.home.q)))
    lowest = (points[1:, 2] - kinematics.guard_radii).min()
    assert 0.4 < lowest < points[0, 2], "the fingers end above the table and below the grip site"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<worldbody>", '<include file="/etc/passwd"/><worldbody>', "has <include>, allowed"),
        ("<worldbody>", '<asset><mesh file="a.stl"/></asset><worldbody>', "has <mesh>, allowed"),
        ("<mujoco", "<mujoko", "is not valid MJCF"),
        ("</mujoco>", "", "is not valid MJCF"),
        (f'"{EE_SITE}"', '"hand"', "no site 'ee'"),
        ("robot0:elbow_flex_joint", "elbow", "has joints .*elbow.*; allowed: hinges and slides"),
    ],
)
def test_a_model_that_cannot_be_used_is_refused(old: str, new: str, message: str) -> None:
    text = SPEC.kinematic_model.replace(old, new)
    assert text != SPEC.kinematic_model
    with pytest.raises(InvalidSpec, match=message):
        Kinematics(dataclasses.replace(SPEC, kinematic_model=text))


def test_a_home_without_joints_is_refused() -> None:
    home = dataclasses.replace(SPEC.home, q=())
    with pytest.raises(InvalidSpec, match=r"home of .* has 0 joint positions, allowed: 8"):
        Kinematics(dataclasses.replace(SPEC, home=home))


def test_the_model_is_the_arm_alone() -> None:
    model = Kinematics(SPEC).model
    assert (model.ngeom, model.nmesh, model.nu, model.neq) == (0, 0, 0, 0)
    assert isinstance(model, mujoco.MjModel)
    assert tuple(model.joint(joint).name for joint in range(model.njnt)) == SPEC.joint_names
