"""Scenes compiled with a robot in them, once in a process."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import lru_cache

import mujoco

from drivers.mujoco.arm import arm_model, arm_start, kinematic_model
from drivers.mujoco.fetch_spec import kinematic_digest
from drivers.mujoco.robot import FetchRobot, SensorParameters
from drivers.mujoco.scene import StartState, find_scene, mocap_model, prepare, settle

_KEPT = 8  # of 9 MB each


@dataclass(frozen=True, eq=False)
class CompiledScene:
    """Model, start state and kinematics of a robot in a scene.

    Attributes:
        model: The scene with the robot in it, a copy of the caller's own.
        start: Where every episode starts.
        kinematics: The arm alone, as MJCF text; in mocap actuation a digest of its tree.
    """

    model: mujoco.MjModel
    start: StartState
    kinematics: str


def compile_scene(scene: str, robot: FetchRobot) -> CompiledScene:
    """Compile a scene with a robot in it, or copy what was compiled for an equal one.

    Args:
        scene: Name of the scene.
        robot: Its parameters.

    Returns:
        The scene with a copy of the model; the arrays of the start state are read-only.

    Raises:
        UnknownDriver: If there is no such scene.
        FileNotFoundError: If gymnasium-robotics is not installed.
    """
    # Sensors are no part of the model.
    compiled = _compiled(scene, robot.model_copy(update={"sensors": SensorParameters()}))
    return CompiledScene(copy.copy(compiled.model), compiled.start, compiled.kinematics)


@lru_cache(maxsize=_KEPT)
def _compiled(name: str, robot: FetchRobot) -> CompiledScene:
    scene = find_scene(name)
    if robot.actuation == "mocap":
        model = mocap_model(scene)
        kinematics = kinematic_digest(model)
        start = settle(model, scene)
    else:
        model = arm_model(scene, robot)
        kinematics = kinematic_model(scene)
        start = arm_start(model, scene)
    prepare(model, robot.object)
    for array in (start.qpos, start.qvel, start.ee_pos, start.ee_quat):
        array.setflags(write=False)
    return CompiledScene(model, start, kinematics)
