"""Actuation of the simulated robot by position-controlled motors in its joints."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray

from drivers.command import Command, JointCommand
from drivers.mujoco.fetch_spec import ARM_JOINTS, FINGERS
from drivers.mujoco.scene import SUBSTEPS
from drivers.state import JointSetpoint

Array = NDArray[np.float64]

N_ARM = len(ARM_JOINTS)
_FARTHEST_GAP = 0.3  # rad, between a joint that is blocked and its setpoint
_WIDTH = 2 * N_ARM + len(FINGERS)


def memory_size(delay_ticks: int) -> int:
    """Return the size of the setpoints in ``MjData.userdata``, in numbers.

    Args:
        delay_ticks: Delay of the motors behind the setpoint, control ticks.
    """
    return (delay_ticks + 2) * _WIDTH


class JointActuation:
    """Position-controlled joints that follow setpoints with constant acceleration in a tick.

    The setpoints of the last ticks are stored in ``MjData.userdata``, so that a copy of the
    simulation is exact. With a delay the motors follow an earlier setpoint.
    """

    def __init__(
        self, model: mujoco.MjModel, brake: Callable[[JointSetpoint], JointSetpoint]
    ) -> None:
        """Look up the motors.

        Args:
            model: Compiled by `arm_model`.
            brake: Returns the setpoint at the end of a tick without a command.
        """
        self._model = model
        self._brake = brake
        names = (*ARM_JOINTS, *FINGERS)
        self._motors = [model.actuator(name).id for name in names]
        self._qpos = np.array([model.joint(name).qposadr[0] for name in names], dtype=np.intp)
        # Velocity feed-forward: damping acts on the difference to the setpoint's velocity.
        dofs = np.array([model.joint(name).dofadr[0] for name in names], dtype=np.intp)
        self._kp = model.actuator_gainprm[self._motors, 0]
        damping = model.dof_damping[dofs] - model.actuator_biasprm[self._motors, 2]
        self._lead_s = damping / self._kp
        self._arm_dofs = dofs[:N_ARM]
        self._qacc, self._torque = np.zeros(model.nv), np.zeros(model.nv)
        self._substep_s = float(model.opt.timestep)

    def begin(self, data: mujoco.MjData) -> None:
        """Hold the robot in a simulation that was just reset."""
        row = np.zeros(_WIDTH)
        row[:N_ARM] = data.qpos[self._qpos[:N_ARM]]
        row[2 * N_ARM :] = data.qpos[self._qpos[N_ARM:]]
        self._memory(data)[:] = row

    def resume(self, data: mujoco.MjData) -> None:
        """Continue with a restored simulation, from its setpoints if it has valid ones."""
        memory = self._memory(data)
        gap = np.abs(memory[0, :N_ARM] - data.qpos[self._qpos[:N_ARM]]).max()
        if not gap < _FARTHEST_GAP:  # not a snapshot of this driver, or changed: hold in place
            self.begin(data)

    def tick(self, data: mujoco.MjData, command: Command | None) -> None:
        """Follow the setpoints for one control tick."""
        memory = self._memory(data)
        memory[:-1] = memory[1:]
        if command is None:
            braked = self._brake(_setpoint(memory[-1]))
            memory[-1] = np.concatenate([braked.q, braked.dq, braked.fingers])
        else:
            assert isinstance(command, JointCommand)
            memory[-1] = np.concatenate([command.q_target, command.dq, command.finger_target])
        self._follow(data, *memory[:2])

    def setpoint(self, data: mujoco.MjData) -> JointSetpoint:
        """Return the newest setpoint, which delayed motors follow later."""
        return _setpoint(self._memory(data)[-1])

    def _follow(self, data: mujoco.MjData, start: Array, end: Array) -> None:
        tick_s = SUBSTEPS * self._substep_s
        acceleration = (end[N_ARM : 2 * N_ARM] - start[N_ARM : 2 * N_ARM]) / tick_s
        finger_speed = (end[2 * N_ARM :] - start[2 * N_ARM :]) / tick_s
        times = self._substep_s * np.arange(SUBSTEPS)[:, None]
        dq = start[N_ARM : 2 * N_ARM] + acceleration * times
        q = start[:N_ARM] + (start[N_ARM : 2 * N_ARM] + dq) / 2.0 * times
        fingers = start[2 * N_ARM :] + finger_speed * times
        speeds = np.broadcast_to(finger_speed, fingers.shape)
        controls = np.hstack([q, fingers]) + self._lead_s * np.hstack([dq, speeds])
        controls[:, :N_ARM] += self._inertia(data, acceleration) / self._kp[:N_ARM]
        for control in controls:
            data.ctrl[self._motors] = control
            mujoco.mj_step(self._model, data)
        mujoco.mj_forward(self._model, data)  # update sites and velocities to the joints

    def _inertia(self, data: mujoco.MjData, acceleration: Array) -> Array:
        """Return the acceleration feed-forward: torques and forces for the arm's inertia, Nm, N."""
        self._qacc[self._arm_dofs] = acceleration
        mujoco.mj_mulM(self._model, data, self._torque, self._qacc)
        return self._torque[self._arm_dofs]

    def _memory(self, data: mujoco.MjData) -> Array:
        memory: Array = data.userdata.reshape(-1, _WIDTH)
        return memory


def _setpoint(row: Array) -> JointSetpoint:
    return JointSetpoint(row[:N_ARM].copy(), row[N_ARM : 2 * N_ARM].copy(), row[2 * N_ARM :].copy())
