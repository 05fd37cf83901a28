"""Sensors of the simulated robot."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from drivers.mujoco.camera import ObjectCamera
from drivers.mujoco.fetch_spec import FINGERS, OBJECT
from drivers.mujoco.robot import SensorParameters
from drivers.spec import RobotSpec
from drivers.state import AppliedCommand, JointSetpoint, Mode, ObjectPose, RobotState

Array = NDArray[np.float64]


class Sensors:
    """Measures robot states in a simulation, with noise. Indices are looked up once."""

    def __init__(
        self, model: mujoco.MjModel, spec: RobotSpec, parameters: SensorParameters
    ) -> None:
        """Look up the indices.

        Args:
            model: The compiled scene.
            spec: The robot's description.
            parameters: Noise, rate and delay of the sensors.
        """
        self._model = model
        self._parameters = parameters
        self._rng = np.random.default_rng(0)
        self._joint_qpos = _addresses(model, spec.joint_names, "qposadr")
        self._joint_dofs = _addresses(model, spec.joint_names, "dofadr")
        self._finger_qpos = _addresses(model, FINGERS, "qposadr")
        self._finger_dofs = _addresses(model, FINGERS, "dofadr")
        self._grip = model.site("robot0:grip").id
        self._gripper = model.body("robot0:gripper_link").id
        source = spec.objects.get(OBJECT)
        self._camera = None if source is None else ObjectCamera(model, source, parameters)
        self._jacp = np.zeros((3, model.nv))
        self._jacr = np.zeros((3, model.nv))

    def begin(self, seed: int) -> None:
        """Drop the camera's measurements, and restart the noise.

        Args:
            seed: Seed of the noise.
        """
        self._rng = np.random.default_rng(seed)
        if self._camera is not None:
            self._camera.begin()

    def read(
        self,
        data: mujoco.MjData,
        seq: int,
        stamp_ns: int,
        mode: Mode,
        fault: str | None,
        applied: AppliedCommand | None,
        setpoint: JointSetpoint | None,
    ) -> RobotState:
        """Measure the state; called once per tick, so that the camera misses none.

        Args:
            data: The simulation.
            seq: Tick counter.
            stamp_ns: Time of the measurement.
            mode: Mode of the robot.
            fault: Name of the latched fault.
            applied: The last command applied.
            setpoint: Target of the motors.
        """
        # By the Jacobian, as in the reference (gymnasium_robotics/utils/mujoco_utils.py,
        # get_site_xvelp), and not by mj_objectVelocity, whose last bits differ.
        mujoco.mj_jacSite(self._model, data, self._jacp, self._jacr, self._grip)
        ee_linvel, ee_angvel = self._jacp @ data.qvel, self._jacr @ data.qvel
        ee_pos = data.site_xpos[self._grip].copy()
        ee_quat = data.xquat[self._gripper].copy()
        q, dq = data.qpos[self._joint_qpos], data.qvel[self._joint_dofs]
        if self._parameters.joint_noise > 0.0:
            error = self._draw(self._parameters.joint_noise, len(q))
            q += error
            ee_pos += self._jacp[:, self._joint_dofs] @ error
            mujoco.mju_quatIntegrate(ee_quat, self._jacr[:, self._joint_dofs] @ error, 1.0)
        if self._parameters.joint_velocity_noise > 0.0:
            error = self._draw(self._parameters.joint_velocity_noise, len(dq))
            dq += error
            ee_linvel += self._jacp[:, self._joint_dofs] @ error
            ee_angvel += self._jacr[:, self._joint_dofs] @ error
        return RobotState(
            seq=seq,
            stamp_ns=stamp_ns,
            q=q,
            dq=dq,
            ee_pos=ee_pos,
            ee_quat=ee_quat,
            ee_linvel=ee_linvel,
            ee_angvel=ee_angvel,
            fingers_pos=data.qpos[self._finger_qpos],
            fingers_vel=data.qvel[self._finger_dofs],
            mode=mode,
            fault=fault,
            applied=applied,
            objects=self._objects(data, stamp_ns),
            setpoint=setpoint,
        )

    def _objects(self, data: mujoco.MjData, stamp_ns: int) -> dict[str, ObjectPose]:
        if self._camera is None:
            return {}
        return {OBJECT: self._camera.see(data, stamp_ns, self._rng)}

    def _draw(self, deviation: float, size: int) -> Array:
        return self._rng.normal(0.0, deviation, size)


def _addresses(model: mujoco.MjModel, names: tuple[str, ...], kind: str) -> NDArray[np.intp]:
    return np.array([getattr(model.joint(name), kind)[0] for name in names], dtype=np.intp)
