"""Clearance limit of the inverse kinematics."""

from __future__ import annotations

import dataclasses
from functools import cache

import mink
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers import Box, JointCommand, Kinematics, RobotSpec, RobotState
from drivers.mujoco import MujocoDriver
from drivers.region import Region
from iher_robot.env.clearance_limit import APPROACH_GAIN, ClearanceLimit
from iher_robot.env.ik_controller import JointController

Array = NDArray[np.float64]
MARGIN_M = 0.005
FORWARD = np.array([0.5, 0.0, 0.0, 0.0])


@cache
def at_home() -> tuple[RobotSpec, RobotState]:
    driver = MujocoDriver("reach")
    with driver:
        return driver.spec, driver.read()


def keeping_out_of(*boxes: Box) -> RobotSpec:
    spec, _ = at_home()
    return dataclasses.replace(spec, limits=dataclasses.replace(spec.limits, keep_out=boxes))


def below_the_gripper(gap_m: float) -> Box:
    """A plate whose top is at a distance below the lowest finger at home."""
    spec, _ = at_home()
    kinematics = Kinematics(spec)
    points = kinematics.guarded_points(np.array(spec.home.q))
    lowest = (points[1:, 2] - kinematics.guard_radii).min()
    return Box((1.0, 0.3, 0.0), (1.7, 1.2, float(lowest) - gap_m))


def inequalities(spec: RobotSpec, retreats: bool) -> tuple[Array, Array, mink.Configuration]:
    kinematics = Kinematics(spec)
    configuration = mink.Configuration(kinematics.model, np.array(spec.home.q))
    limit = ClearanceLimit(spec, kinematics, MARGIN_M, retreats)
    found = limit.compute_qp_inequalities(configuration, spec.control_period_s)
    assert found.G is not None
    assert found.h is not None
    return found.G, found.h, configuration


def moved_m(spec: RobotSpec, action: Array) -> Array:
    _, state = at_home()
    command = JointController(spec, blocks_gripper=True).command(action, state)
    assert isinstance(command, JointCommand)
    jacobian = Kinematics(spec).ee_jacobian(np.array(spec.home.q))
    moved: Array = jacobian @ command.dq * spec.control_period_s
    return moved


def test_its_rows_are_the_jacobian_of_the_depths() -> None:
    spec = keeping_out_of(below_the_gripper(0.02))
    approach, most, _ = inequalities(spec, retreats=True)
    kinematics, region, home = Kinematics(spec), Region(spec.limits), np.array(spec.home.q)

    def depths(q: Array) -> Array:
        points = kinematics.guarded_points(q)
        return np.concatenate(list(region.depths(points, kinematics.guard_radii).values()))

    near = depths(home) > -0.1
    assert near.sum() == len(approach) > 4
    steps = 1e-6 * np.eye(len(home))
    change = [(depths(home + step) - depths(home - step))[near] / 2e-6 for step in steps]
    np.testing.assert_allclose(approach, np.transpose(change), atol=1e-6)
    np.testing.assert_allclose(most, APPROACH_GAIN * (-depths(home)[near] - MARGIN_M))


def test_inside_the_margin_zero_motion_is_a_solution_unless_it_must_retreat() -> None:
    spec = keeping_out_of(below_the_gripper(-0.02))
    assert inequalities(spec, retreats=False)[1].min() == 0.0
    assert -0.004 < inequalities(spec, retreats=True)[1].min() < 0.0


def test_far_from_obstacles_it_limits_nothing() -> None:
    spec, _ = at_home()
    limits = dataclasses.replace(
        spec.limits, keep_out=(), workspace=Box((-9.0, -9.0, -9.0), (9.0, 9.0, 9.0))
    )
    kinematics = Kinematics(spec)
    limit = ClearanceLimit(dataclasses.replace(spec, limits=limits), kinematics, 0.005, True)
    configuration = mink.Configuration(kinematics.model, np.array(spec.home.q))
    assert limit.compute_qp_inequalities(configuration, 0.04).inactive


@pytest.mark.parametrize("gap_m", [0.0, MARGIN_M, 0.01])
def test_a_motion_into_a_face_becomes_one_along_it(gap_m: float) -> None:
    spec = keeping_out_of(below_the_gripper(gap_m))
    moved = moved_m(spec, np.array([0.5, 0.0, -0.5, 0.0]))
    assert moved[0] > 0.01
    assert -0.005 < moved[2] < 0.003


def test_between_two_walls_it_still_moves_along_them() -> None:
    spec, _ = at_home()
    y, gap_m = spec.home.ee_pos[1], 0.062  # the gripper's sphere has a radius of 60 mm
    right, left = (
        Box((1.2, 0.3, 0.0), (1.7, y - gap_m, 1.2)),
        Box((1.2, y + gap_m, 0.0), (1.7, 1.2, 1.2)),
    )
    narrow = keeping_out_of(right, left)
    assert (inequalities(narrow, retreats=True)[1] < 0.0).sum() >= 2
    moved = moved_m(narrow, FORWARD)
    assert moved[0] > 0.01
    assert abs(moved[1]) < 0.002
