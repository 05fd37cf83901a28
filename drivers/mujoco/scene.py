"""Scenes of gymnasium-robotics' Fetch environments: models, constants, start states."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from drivers.errors import UnknownDriver
from drivers.mujoco.robot import ObjectParameters
from drivers.names import unknown

SUBSTEPS = 20
"""Physics steps of one control tick (`envs/fetch/push.py`, ``n_substeps``)."""

POINTING_DOWN = np.array([1.0, 0.0, 1.0, 0.0])
"""Orientation of the mocap body, wxyz, not normalised, as the reference uses it."""

_SETTLING_TICKS = 10


@dataclass(frozen=True)
class FetchScene:
    """One scene, with the constants of `gymnasium_robotics/envs/fetch/*.py`.

    Attributes:
        file: Model file below ``envs/assets/fetch``.
        base_x: Position of the base along x, slide joint 0, m.
        gripper_height: Extra height of the gripper at home, m.
        locked_fingers: Whether the fingers are kept closed.
        object_qpos: Pose from which the object settles, position and wxyz; None without one.
    """

    file: str
    base_x: float
    gripper_height: float
    locked_fingers: bool
    object_qpos: tuple[float, ...] | None


SCENES = {
    "reach": FetchScene("reach.xml", 0.4049, 0.2, True, None),
    "push": FetchScene("push.xml", 0.405, 0.0, True, (1.25, 0.53, 0.4, 1.0, 0.0, 0.0, 0.0)),
    "pick_and_place": FetchScene(
        "pick_and_place.xml", 0.405, 0.2, False, (1.25, 0.53, 0.4, 1.0, 0.0, 0.0, 0.0)
    ),
    "slide": FetchScene("slide.xml", 0.05, -0.02, True, (1.7, 1.1, 0.41, 1.0, 0.0, 0.0, 0.0)),
}


def find_scene(name: str) -> FetchScene:
    """Return a scene by name.

    Raises:
        UnknownDriver: If there is no such scene.
    """
    if name not in SCENES:
        raise UnknownDriver(unknown("scene of driver 'mujoco':", name, SCENES))
    return SCENES[name]


def assets_folder() -> Path:
    """Return the folder of the Fetch model files, in gymnasium-robotics.

    Raises:
        FileNotFoundError: If gymnasium-robotics is not installed.
    """
    # Not by an import, which registers two hundred environments and prints notices.
    found = importlib.util.find_spec("gymnasium_robotics")
    if found is None or not found.submodule_search_locations:
        raise FileNotFoundError(
            "gymnasium-robotics, which contains the Fetch model files, is not installed; install it"
        )
    return Path(found.submodule_search_locations[0]) / "envs" / "assets" / "fetch"


def mocap_model(scene: FetchScene) -> mujoco.MjModel:
    """Compile a scene whose robot is dragged by a mocap body, as in the reference.

    Raises:
        FileNotFoundError: If gymnasium-robotics is not installed.
    """
    model = mujoco.MjModel.from_xml_path(str(assets_folder() / scene.file))
    model.eq_data[:, :7] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)  # the weld holds without an offset
    return model


def prepare(model: mujoco.MjModel, parameters: ObjectParameters) -> None:
    """Set mass and friction of the object, and hide the model's mark of the goal.

    Args:
        model: The compiled scene, changed in place.
        parameters: Parameters of the object.
    """
    model.site("target0").rgba[3] = 0.0  # the renderer draws the goal at its position
    bodies = [body for body in range(model.nbody) if model.body(body).name in ("object0", "table0")]
    for body in bodies:
        first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
        geoms = slice(first, first + count)
        # The greater friction of two bodies in contact applies, so both are scaled.
        model.geom_friction[geoms, 0] *= parameters.friction_scale
        if model.body(body).name == "object0":
            model.body_mass[body] *= parameters.mass_scale
            model.body_inertia[body] *= parameters.mass_scale
    mujoco.mj_setConst(model, mujoco.MjData(model))


@dataclass(frozen=True, eq=False)
class StartState:
    """State of a simulation that a reset restores.

    Attributes:
        qpos: ``(nq,)``
        qvel: ``(nv,)``
        time: s.
        ee_pos: Gripper site at the end of the set-up, m. After a reset it is up to 0.2 mm away,
            because here positions lag the joints by one sub-step. ``(3,)``
        ee_quat: Gripper body, wxyz. ``(4,)``
        object_height: Height of the object's site at that moment, None without an object.
    """

    qpos: NDArray[np.float64]
    qvel: NDArray[np.float64]
    time: float
    ee_pos: NDArray[np.float64]
    ee_quat: NDArray[np.float64]
    object_height: float | None


def settle(model: mujoco.MjModel, scene: FetchScene, lift_m: float = 0.0) -> StartState:
    """Move the gripper home, as `MujocoFetchEnv._env_setup` does.

    Args:
        model: Compiled by `mocap_model`.
        scene: Its constants.
        lift_m: Additional height of the gripper.

    Returns:
        The start state of every episode.
    """
    data = mujoco.MjData(model)
    base = [model.joint(f"robot0:slide{axis}").qposadr[0] for axis in range(3)]
    data.qpos[base] = (scene.base_x, 0.48, 0.0)
    if scene.object_qpos is not None:
        address = model.joint("object0:joint").qposadr[0]
        data.qpos[address : address + 7] = scene.object_qpos
    mujoco.mj_forward(model, data)
    grip = data.site("robot0:grip")
    offset = np.array([-0.498, 0.005, -0.431 + scene.gripper_height + lift_m])
    data.mocap_pos[0] = offset + grip.xpos
    data.mocap_quat[0] = POINTING_DOWN
    for _ in range(_SETTLING_TICKS):
        mujoco.mj_step(model, data, nstep=SUBSTEPS)
    return start_of(data, scene)


def start_of(data: mujoco.MjData, scene: FetchScene) -> StartState:
    """Return the state of a simulation as a start state."""
    has_object = scene.object_qpos is not None
    return StartState(
        qpos=data.qpos.copy(),
        qvel=data.qvel.copy(),
        time=data.time,
        ee_pos=data.site("robot0:grip").xpos.copy(),
        ee_quat=data.body("robot0:gripper_link").xquat.copy(),
        object_height=float(data.site("object0").xpos[2]) if has_object else None,
    )
