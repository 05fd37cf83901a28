"""A scene is compiled once in a process, and each driver has its own copy of it."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
import pytest

from drivers import UnknownDriver
from drivers.mujoco import FetchRobot, MujocoDriver
from drivers.mujoco.compiled import compile_scene
from drivers.mujoco.robot import ObjectParameters, SensorParameters

ROBOTS = [FetchRobot(), FetchRobot(actuation="mocap")]
by_robot = pytest.mark.parametrize("robot", ROBOTS, ids=["joint", "mocap"])


def arrays(model: mujoco.MjModel) -> Iterator[tuple[str, np.ndarray]]:
    for name in dir(model):
        if not name.startswith("_") and isinstance(getattr(model, name), np.ndarray):
            yield name, getattr(model, name)


@by_robot
def test_equal_robots_have_equal_models_that_share_no_memory(robot: FetchRobot) -> None:
    one = compile_scene("push", robot)
    other = compile_scene("push", robot.model_copy(deep=True))
    assert one.start is other.start
    others = dict(arrays(other.model))
    assert len(others) > 100
    for name, array in arrays(one.model):
        np.testing.assert_array_equal(array, others[name], name)
        assert not np.shares_memory(array, others[name]), name


@by_robot
def test_a_driver_that_changes_its_model_changes_no_other(robot: FetchRobot) -> None:
    def falls(driver: MujocoDriver) -> float:
        driver.open()
        before = driver.snapshot().qpos[-7:].copy()
        for _ in range(5):
            driver.advance()
        return float(np.abs(driver.snapshot().qpos[-7:] - before).max())

    changed, same = MujocoDriver("push", robot), MujocoDriver("push", robot)
    changed._model.opt.gravity[:] = (0.0, 0.0, 9.81)
    later = MujocoDriver("push", robot)
    assert falls(changed) > 0.05
    assert falls(same) == falls(later) < 0.005


def test_a_start_cannot_be_written_to() -> None:
    start = compile_scene("reach", FetchRobot()).start
    for array in (start.qpos, start.qvel, start.ee_pos, start.ee_quat):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


def test_whatever_is_in_the_model_tells_robots_apart() -> None:
    plain = compile_scene("push", FetchRobot())
    heavy = compile_scene("push", FetchRobot(object=ObjectParameters(mass_scale=3)))
    noisy = compile_scene("push", FetchRobot(sensors=SensorParameters(joint_noise=0.01)))
    body = plain.model.body("object0").id
    assert heavy.model.body_mass[body] == 3 * plain.model.body_mass[body]
    assert noisy.start is plain.start, "sensors are not compiled"
    assert compile_scene("slide", FetchRobot()).start is not plain.start


def test_an_unknown_scene_is_an_error() -> None:
    with pytest.raises(UnknownDriver, match="nowhere"):
        compile_scene("nowhere", FetchRobot())
