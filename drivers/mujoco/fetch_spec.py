"""The simulated Fetch robot's description of itself."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from drivers.canonical import digest
from drivers.limits import Box, GripperLimits, JointLimits, Limits
from drivers.mujoco.scene import SUBSTEPS, FetchScene, StartState
from drivers.spec import ActionSpec, Home, ObjectSource, RobotSpec

OBJECT = "object0"
FINGERS = ("robot0:r_gripper_finger_joint", "robot0:l_gripper_finger_joint")

# Velocity and acceleration as fetch_ros declares them (fetch_moveit_config/joint_limits.yaml);
# positions come from the model.
_RATES = {
    "robot0:torso_lift_joint": (0.1, 0.5),
    "robot0:shoulder_pan_joint": (1.256, 1.5),
    "robot0:shoulder_lift_joint": (1.0, 1.0),
    "robot0:upperarm_roll_joint": (1.57, 1.5),
    "robot0:elbow_flex_joint": (1.5, 1.5),
    "robot0:forearm_roll_joint": (1.57, 1.5),
    "robot0:wrist_flex_joint": (2.26, 2.5),
    "robot0:wrist_roll_joint": (2.26, 2.5),
}


def fetch_spec(
    model: mujoco.MjModel, scene_name: str, scene: FetchScene, start: StartState
) -> RobotSpec:
    """Describe the robot of a scene in mocap actuation.

    Args:
        model: The compiled scene.
        scene_name: Name of the scene.
        scene: Its constants.
        start: Where an episode starts.

    Returns:
        The description. Its joint limits are those of the real robot, and are not enforced:
        a mocap body drags the arm along.
    """
    period_s = SUBSTEPS * model.opt.timestep
    has_object = scene.object_qpos is not None
    sources = {OBJECT: ObjectSource("simulator", "world", max_age_s=period_s)}
    heights = {} if start.object_height is None else {OBJECT: start.object_height}
    x, y, z = map(float, start.ee_pos)
    qw, qx, qy, qz = map(float, start.ee_quat)
    return RobotSpec(
        name=f"fetch-mujoco-mocap-{scene_name}",
        command_kinds=("ee_delta",),
        action=ActionSpec(),
        control_period_s=period_s,
        frame="world",
        objects=sources if has_object else {},
        finger_names=FINGERS,
        limits=_limits(model, watchdog_s=2.5 * period_s),
        gains={},
        calibration_id="simulated",
        kinematic_model=kinematic_digest(model),
        home=Home((x, y, z), (qw, qx, qy, qz), heights),
        physical=False,
        hold_on_silence_s=None,
        enforces_joint_limits=False,
    )


def _limits(model: mujoco.MjModel, watchdog_s: float) -> Limits:
    joints = {}
    for name, (velocity, acceleration) in _RATES.items():
        joint = model.joint(name)
        limited = bool(joint.limited[0])
        lower, upper = map(float, joint.range) if limited else (-math.inf, math.inf)
        joints[name] = JointLimits(lower, upper, velocity, acceleration)
    closed, opened = map(float, model.joint(FINGERS[0]).range)
    return Limits(
        joints=joints,
        gripper=GripperLimits(closed, opened, max_speed_m_s=0.05),
        max_ee_speed_m_s=1.0,
        workspace=Box((0.6, 0.2, 0.4), (1.8, 1.3, 1.2)),
        watchdog_s=watchdog_s,
    )


def kinematic_digest(model: mujoco.MjModel) -> str:
    """Hash the robot's kinematic tree: bodies, parents, offsets, joint axes.

    Args:
        model: Any scene with the robot in it.

    Returns:
        The same for every scene and for every start, 64 hexadecimal digits.
    """
    bodies = [body for body in range(model.nbody) if model.body(body).name.startswith("robot0:")]
    joints = [joint for joint in range(model.njnt) if model.joint(joint).name.startswith("robot0:")]

    def rows(values: np.ndarray, indices: list[int]) -> list[list[float]]:
        return [[round(float(number), 9) for number in np.ravel(values[i])] for i in indices]

    return digest(
        {
            "bodies": [model.body(body).name for body in bodies],
            "parents": [model.body(int(model.body_parentid[body])).name for body in bodies],
            "offsets": rows(model.body_pos, bodies),
            "orientations": rows(model.body_quat, bodies),
            "joints": [model.joint(joint).name for joint in joints],
            "axes": rows(model.jnt_axis, joints),
            "anchors": rows(model.jnt_pos, joints),
        }
    )
