"""Description of the simulated Fetch robot."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from drivers.canonical import digest
from drivers.command import EndEffectorCommand, JointCommand
from drivers.limits import Box, GripperLimits, JointLimits, Limits, Vector3
from drivers.mujoco.robot import FetchRobot
from drivers.mujoco.scene import SUBSTEPS, FetchScene, StartState
from drivers.spec import ActionSpec, Home, ObjectSource, RobotSpec

OBJECT = "object0"
FINGERS = ("robot0:r_gripper_finger_joint", "robot0:l_gripper_finger_joint")

ARM_JOINTS = tuple(
    f"robot0:{name}_joint"
    for name in (
        "torso_lift",
        "shoulder_pan",
        "shoulder_lift",
        "upperarm_roll",
        "elbow_flex",
        "forearm_roll",
        "wrist_flex",
        "wrist_roll",
    )
)
"""Joints of torso and arm, from the base outwards."""

# Greatest velocity, as fetch_ros declares it (fetch_description/robots/fetch.urdf).
_VELOCITIES = (0.1, 1.256, 1.454, 1.571, 1.521, 1.571, 2.268, 2.268)
# Capability of the motors, rounded down: the torque limit of fetch.urdf less gravity, over the
# inertia about the joint at home, but at most 60 rad/s^2. The limits that fetch_ros plans with
# (fetch_moveit_config/joint_limits.yaml: 1.0 to 2.5 rad/s^2) are a planner's choice: with them
# reaching full speed takes a second, half an episode.
_ACCELERATIONS = (0.5, 11.0, 40.0, 60.0, 60.0, 60.0, 60.0, 60.0)
# As the real robot (Fetch Robotics, data sheet: 1.0 m/s).
_EE_SPEED = 1.0
# Its lower end is where the fingers, which end 18.5 mm below the grip site, touch the table.
_WORKSPACE = Box((0.6, 0.2, 0.4185), (1.8, 1.3, 1.2))
# In mocap actuation no limit may change the reference: no episode of it reaches these.
_MOCAP_EE_SPEED = 2.2
_MOCAP_WORKSPACE = Box((-1.0, -1.0, -0.5), (3.0, 2.5, 2.5))

_WATCHDOG_TICKS = 2.5


def fetch_spec(
    model: mujoco.MjModel,
    scene_name: str,
    scene: FetchScene,
    start: StartState,
    robot: FetchRobot,
    kinematic_model: str,
) -> RobotSpec:
    """Describe the robot of a scene.

    Args:
        model: The compiled scene.
        scene_name: Name of the scene.
        scene: Its constants.
        start: Start state of an episode.
        robot: Parameters of the robot.
        kinematic_model: The arm, as text.

    Returns:
        The description. In mocap actuation its joint limits are not enforced.
    """
    period_s = SUBSTEPS * model.opt.timestep
    mocap = robot.actuation == "mocap"
    heights = {} if start.object_height is None else {OBJECT: start.object_height}
    x, y, z = map(float, start.ee_pos)
    qw, qx, qy, qz = map(float, start.ee_quat)
    limits = _limits(model, robot, watchdog_s=_WATCHDOG_TICKS * period_s)
    return RobotSpec(
        name=f"fetch-mujoco-{robot.actuation}-{scene_name}",
        command_kinds=(EndEffectorCommand.kind if mocap else JointCommand.kind,),
        action=ActionSpec() if mocap else _joint_action(limits, period_s),
        control_period_s=period_s,
        frame="world",
        objects={} if scene.object_qpos is None else {OBJECT: _camera(robot, period_s)},
        finger_names=FINGERS,
        limits=limits,
        gains={} if mocap else _gains(robot),
        calibration_id="simulated",
        kinematic_model=kinematic_model,
        home=Home((x, y, z), (qw, qx, qy, qz), heights, _home_q(model, start)),
        physical=False,
        hold_on_silence_s=None,
        enforces_joint_limits=not mocap,
    )


def _home_q(model: mujoco.MjModel, start: StartState) -> tuple[float, ...]:
    return tuple(float(start.qpos[model.joint(name).qposadr[0]]) for name in ARM_JOINTS)


def _joint_action(limits: Limits, period_s: float) -> ActionSpec:
    """Scale of an action as in mocap actuation, where 1 moves 33 mm; fingers at full speed."""
    return ActionSpec(
        position_scale_m=0.033, gripper_scale_m=limits.gripper.max_speed_m_s * period_s
    )


def _gains(robot: FetchRobot) -> dict[str, float]:
    return {
        "arm_kp": robot.arm.kp,
        "arm_damping_ratio": robot.arm.damping_ratio,
        "finger_kp": robot.gripper.kp,
    }


def _camera(robot: FetchRobot, period_s: float) -> ObjectSource:
    sensors = robot.sensors
    between_s = 0.0 if sensors.object_rate_hz is None else 1.0 / sensors.object_rate_hz
    # The age just before the next measurement arrives, plus the time for which any measurement may
    # be used: a robot served in real time publishes a state up to a tick after its measurement.
    age_s = between_s + sensors.object_delay_s + _WATCHDOG_TICKS * period_s
    return ObjectSource("simulator", "world", max_age_s=age_s)


def _limits(model: mujoco.MjModel, robot: FetchRobot, watchdog_s: float) -> Limits:
    joints = {}
    for name, velocity, acceleration in zip(ARM_JOINTS, _VELOCITIES, _ACCELERATIONS, strict=True):
        joint = model.joint(name)
        limited = bool(joint.limited[0])
        lower, upper = map(float, joint.range) if limited else (-math.inf, math.inf)
        most = acceleration * robot.arm.acceleration_scale
        joints[name] = JointLimits(lower, upper, velocity, most)
    closed, opened = map(float, model.joint(FINGERS[0]).range)
    mocap = robot.actuation == "mocap"
    return Limits(
        joints=joints,
        gripper=GripperLimits(closed, opened, max_speed_m_s=0.05),
        max_ee_speed_m_s=_MOCAP_EE_SPEED if mocap else _EE_SPEED,
        workspace=_MOCAP_WORKSPACE if mocap else _WORKSPACE,
        watchdog_s=watchdog_s,
        keep_out=() if mocap else (_table(model), _head(model)),
    )


def _table(model: mujoco.MjModel) -> Box:
    body = model.body("table0")
    geom = int(body.geomadr[0])
    half, centre = model.geom_size[geom], body.pos + model.geom_pos[geom]
    return Box(_corner(centre - half), _corner(centre + half))


def _head(model: mujoco.MjModel) -> Box:
    """Return a box around the robot's own head, which a bent arm could hit."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    points = []
    for name in ("robot0:head_pan_link", "robot0:head_tilt_link"):
        geom = int(model.body(name).geomadr[0])
        mesh = model.mesh(int(model.geom_dataid[geom]))
        first, count = int(mesh.vertadr[0]), int(mesh.vertnum[0])
        vertices = model.mesh_vert[first : first + count]
        points.append(vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom])
    lower, upper = np.vstack(points).min(axis=0), np.vstack(points).max(axis=0)
    return Box(_corner(lower), _corner(upper))


def _corner(point: NDArray[np.float64]) -> Vector3:
    x, y, z = map(float, point)
    return x, y, z


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
