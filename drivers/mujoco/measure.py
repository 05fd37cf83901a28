"""What the simulated robot senses."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from drivers.mujoco.fetch_spec import FINGERS, OBJECT
from drivers.spec import RobotSpec
from drivers.state import AppliedCommand, Mode, ObjectPose, RobotState

Array = NDArray[np.float64]


class Sensors:
    """Reads robot states out of a simulation. Indices are looked up once."""

    def __init__(self, model: mujoco.MjModel, spec: RobotSpec) -> None:
        """Look up what to read.

        Args:
            model: The compiled scene.
            spec: The robot's description.
        """
        self._model = model
        self._source = spec.objects.get(OBJECT)
        self._joint_qpos = _addresses(model, spec.joint_names, "qposadr")
        self._joint_dofs = _addresses(model, spec.joint_names, "dofadr")
        self._finger_qpos = _addresses(model, FINGERS, "qposadr")
        self._finger_dofs = _addresses(model, FINGERS, "dofadr")
        self._grip = model.site("robot0:grip").id
        self._gripper = model.body("robot0:gripper_link").id
        if self._source is not None:
            self._object_site = model.site(OBJECT).id
            self._object_body = model.body(OBJECT).id
        self._jacp = np.zeros((3, model.nv))
        self._jacr = np.zeros((3, model.nv))

    def read(
        self,
        data: mujoco.MjData,
        seq: int,
        stamp_ns: int,
        mode: Mode,
        fault: str | None,
        applied: AppliedCommand | None,
    ) -> RobotState:
        """Measure everything at once.

        Args:
            data: The simulation.
            seq: Tick counter.
            stamp_ns: Time of the measurement.
            mode: What the robot is doing.
            fault: Name of the latched fault.
            applied: The last command applied.
        """
        ee_linvel, ee_angvel = self._site_velocity(data, self._grip)
        return RobotState(
            seq=seq,
            stamp_ns=stamp_ns,
            q=data.qpos[self._joint_qpos],
            dq=data.qvel[self._joint_dofs],
            ee_pos=data.site_xpos[self._grip].copy(),
            ee_quat=data.xquat[self._gripper].copy(),
            ee_linvel=ee_linvel,
            ee_angvel=ee_angvel,
            fingers_pos=data.qpos[self._finger_qpos],
            fingers_vel=data.qvel[self._finger_dofs],
            mode=mode,
            fault=fault,
            applied=applied,
            objects=self._objects(data, stamp_ns),
        )

    def _objects(self, data: mujoco.MjData, stamp_ns: int) -> dict[str, ObjectPose]:
        if self._source is None:
            return {}
        linvel, angvel = self._site_velocity(data, self._object_site)
        pose = ObjectPose(
            pos=data.site_xpos[self._object_site].copy(),
            quat=data.xquat[self._object_body].copy(),
            linvel=linvel,
            angvel=angvel,
            stamp_ns=stamp_ns,
            source=self._source.source,
            frame=self._source.frame,
        )
        return {OBJECT: pose}

    def _site_velocity(self, data: mujoco.MjData, site: int) -> tuple[Array, Array]:
        # By the Jacobian and not by mj_objectVelocity, whose last bits differ: the reference
        # does it this way (gymnasium_robotics/utils/mujoco_utils.py, get_site_xvelp).
        mujoco.mj_jacSite(self._model, data, self._jacp, self._jacr, site)
        return self._jacp @ data.qvel, self._jacr @ data.qvel


def _addresses(model: mujoco.MjModel, names: tuple[str, ...], kind: str) -> NDArray[np.intp]:
    return np.array([getattr(model.joint(name), kind)[0] for name in names], dtype=np.intp)
