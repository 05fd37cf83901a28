"""Models of the Fetch robot with motors in its joints, built from gymnasium-robotics' assets."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # it warns without a display, which is not used here
    from dm_control import mjcf

from drivers.kinematics import EE_SITE, GUARD_PREFIX
from drivers.mujoco.fetch_spec import ARM_JOINTS, FINGERS
from drivers.mujoco.robot import FetchRobot
from drivers.mujoco.scene import (
    FetchScene,
    StartState,
    assets_folder,
    mocap_model,
    settle,
    start_of,
)
from drivers.mujoco.servo import memory_size

_PREFIX = "robot0:"
_BASE_Y = 0.48  # slide joint 1 of the reference at its start (``FetchPushEnv.__init__``)
_BASE_SLIDES = ("slide0", "slide1", "slide2")
_HEAD_JOINTS = ("head_pan_joint", "head_tilt_joint")
# At rest the torso is below the range in the model file, which would push it up by 37 mm, but
# within that of the robot's own description (fetch_description/robots/fetch.urdf).
_TORSO_RANGE = (0.0, 0.3861)
_TORSO_DAMPING = 100.0
# The table's top is at 0.4 m and the fingers end 18.5 mm below the grip site.
_LOWEST_HOME_M = 0.4235
# Parts of the arm that could hit the table or the head, as spheres along each link: positions
# along x of the body's frame and radius, m. Of the fingers the tip corners, closed and open.
_LINK_GUARDS = {
    "upperarm_roll_link": ((0.0, 0.07), 0.06),
    "elbow_flex_link": ((0.0, 0.1), 0.06),
    "forearm_roll_link": ((0.0, 0.06), 0.06),
    "wrist_flex_link": ((0.0, 0.07), 0.06),
    "wrist_roll_link": ((0.0,), 0.05),
    "gripper_link": ((-0.09,), 0.06),
}
_POINT = 1e-6
_FINGER_TIP = (0.0385, 0.015, 0.0135)  # half extents; thickness to the outer side
_FINGER_OPEN = 0.05


def arm_model(scene: FetchScene, robot: FetchRobot) -> mujoco.MjModel:
    """Compile a scene whose robot has position-controlled joints.

    The weld, the mocap body and the joints of base and head are removed. Gravity is compensated
    on the robot, as by the controllers of the real one.

    Args:
        scene: The scene.
        robot: Its parameters.
    """
    root = _without_mocap(scene)
    for body in root.find("body", _PREFIX + "base_link").find_all("body"):
        body.gravcomp = 1.0
    for name in ARM_JOINTS:
        joint = root.find("joint", name)
        joint.damping = robot.arm.joint_damping
        if name == ARM_JOINTS[0]:
            joint.damping = _TORSO_DAMPING
            joint.range = _TORSO_RANGE
        root.actuator.add(
            "position", name=name, joint=joint, kp=robot.arm.kp, dampratio=robot.arm.damping_ratio
        )
    for name in FINGERS:
        force = robot.gripper.max_force_n
        root.actuator.add(
            "position", name=name, joint=name, kp=robot.gripper.kp, forcerange=(-force, force)
        )
    root.option.integrator = "implicitfast"
    root.size.nuserdata = memory_size(robot.arm.delay_ticks)
    return _compile(root)


def kinematic_model(scene: FetchScene) -> str:
    """Return the arm alone, at its place in a scene, as MJCF text for `Kinematics`.

    Args:
        scene: The scene.
    """
    root = _without_mocap(scene)
    for name, pos, radius in _guards():
        body = root.find("body", _PREFIX + name)
        number = len(body.site)
        body.add("site", name=f"{GUARD_PREFIX}{name}:{number}", pos=pos, size=(radius,) * 3)
    gripper = root.find("body", _PREFIX + "gripper_link")
    grip = root.find("site", _PREFIX + "grip")
    gripper.add("site", name=EE_SITE, pos=grip.pos)
    grip.remove()
    for kind in ("geom", "camera", "light", "equality", "contact"):
        for element in root.find_all(kind):
            element.remove()
    for site in root.find_all("site"):
        if site.name != EE_SITE and not site.name.startswith(GUARD_PREFIX):
            site.remove()
    for joint in root.find_all("joint"):
        if joint.name not in ARM_JOINTS:
            joint.remove()
    for body in root.worldbody.body:
        if body.name != _PREFIX + "base_link":
            body.remove()
    root.find("joint", ARM_JOINTS[0]).range = _TORSO_RANGE
    for asset in (*root.asset.mesh, *root.asset.texture, *root.asset.material):
        asset.remove()
    return str(root.to_xml_string(prefix_root=""))


def arm_start(model: mujoco.MjModel, scene: FetchScene) -> StartState:
    """Return the start state of the reference for a robot with motors, lifted off the table.

    In the reference the fingers of Push and Slide press on the table at home, where the mocap body
    brings them; motors would press permanently.

    Args:
        model: Compiled by `arm_model`.
        scene: The scene.
    """
    dragged = mocap_model(scene)
    lift_m, start = 0.0, settle(dragged, scene)
    while start.ee_pos[2] < _LOWEST_HOME_M:  # the table holds it up by an unknown distance
        lift_m += 0.005
        start = settle(dragged, scene, lift_m)
    data = mujoco.MjData(model)
    for joint in range(model.njnt):
        name, to = model.joint(joint).name, int(model.jnt_qposadr[joint])
        width = 7 if name.startswith("object") else 1
        origin = int(dragged.joint(name).qposadr[0])
        data.qpos[to : to + width] = start.qpos[origin : origin + width]
    data.qpos[[int(model.joint(name).qposadr[0]) for name in FINGERS]] = 0.0
    data.time = start.time
    mujoco.mj_forward(model, data)
    return start_of(data, scene)


def _guards() -> Iterator[tuple[str, tuple[float, float, float], float]]:
    """Yield body, position in its frame and radius of each guarded sphere."""
    for name, (along, radius) in _LINK_GUARDS.items():
        for x in along:
            yield name, (x, 0.0, 0.0), radius
    length, outer, half_width = _FINGER_TIP
    for side, name in ((-1.0, "r_gripper_finger_link"), (1.0, "l_gripper_finger_link")):
        for opened in (0.0, _FINGER_OPEN):
            for z in (-half_width, half_width):
                yield name, (length, side * (outer - opened), z), _POINT


def _without_mocap(scene: FetchScene) -> Any:
    root = mjcf.from_xml_string(_inlined(assets_folder() / scene.file), model_dir=assets_folder())
    for weld in root.equality.weld:
        weld.remove()
    root.find("body", _PREFIX + "mocap").remove()
    base = root.find("body", _PREFIX + "base_link")
    for name in (*_BASE_SLIDES, *_HEAD_JOINTS):
        root.find("joint", _PREFIX + name).remove()
    base.pos = np.add(base.pos, (scene.base_x, _BASE_Y, 0.0))
    for actuator in root.find_all("actuator"):
        actuator.remove()
    return root


def _inlined(path: Path) -> str:
    """Read a model file and inline its includes: PyMJCF loses the textures of included files."""
    root = ElementTree.parse(path).getroot()
    for parent in root.iter():
        for index, child in reversed(list(enumerate(parent))):
            if child.tag == "include":
                included = ElementTree.parse(path.parent / child.attrib["file"]).getroot()
                parent[index : index + 1] = list(included)
    return ElementTree.tostring(root, encoding="unicode")


def _compile(root: Any) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(root.to_xml_string(), root.get_assets())
