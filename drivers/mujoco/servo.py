"""Motors in the joints of the simulated robot."""

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
_FARTHEST_GAP = 0.3  # rad, between a joint that is held up by something and its setpoint
_WIDTH = 2 * N_ARM + len(FINGERS)


def memory_size(delay_ticks: int) -> int:
    """Return how many numbers of ``MjData.userdata`` the setpoints take.

    Args:
        delay_ticks: Control ticks from a setpoint to the motors' following it.
    """
    return (delay_ticks + 2) * _WIDTH


class JointActuation:
    """Position-controlled joints that follow setpoints with constant acceleration in a tick.

    The setpoints of the last ticks are kept in ``MjData.userdata``, so that a copy of the
    simulation is exact. With a delay the motors follow those of some ticks ago.
    """

    def __init__(
        self, model: mujoco.MjModel, brake: Callable[[JointSetpoint], JointSetpoint]
    ) -> None:
        """Look the motors up.

        Args:
            model: Compiled by `arm_model`.
            brake: Returns the end of a tick without a command.
        """
        self._model = model
        self._brake = brake
        names = (*ARM_JOINTS, *FINGERS)
        self._motors = [model.actuator(name).id for name in names]
        self._qpos = np.array([model.joint(name).qposadr[0] for name in names], dtype=np.intp)
        # Feed-forward of velocity: damping acts on the difference to the setpoint's velocity.
        dofs = np.array([model.joint(name).dofadr[0] for name in names], dtype=np.intp)
        self._kp = model.actuator_gainprm[self._motors, 0]
        damping = model.dof_damping[dofs] - model.actuator_biasprm[self._motors, 2]
        self._lead_s = damping / self._kp
        self._arm_dofs = dofs[:N_ARM]
        self._qacc, self._torque = np.zeros(model.nv), np.zeros(model.nv)
        self._substep_s = float(model.opt.timestep)

    def begin(self, data: mujoco.MjData) -> None:
        """Hold what was just set up."""
        row = np.zeros(_WIDTH)
        row[:N_ARM] = data.qpos[self._qpos[:N_ARM]]
        row[2 * N_ARM :] = data.qpos[self._qpos[N_ARM:]]
        self._memory(data)[:] = row

    def resume(self, data: mujoco.MjData) -> None:
        """Go on with a simulation that was restored: its setpoints are in it, if it has any."""
        memory = self._memory(data)
        gap = np.abs(memory[0, :N_ARM] - data.qpos[self._qpos[:N_ARM]]).max()
        if not gap < _FARTHEST_GAP:  # not a snapshot of ours, or a changed one: hold where it is
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
        """Return the newest setpoint, which with a delay the motors have yet to follow."""
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
        mujoco.mj_forward(self._model, data)  # sites and velocities up to date with the joints

    def _inertia(self, data: mujoco.MjData, acceleration: Array) -> Array:
        """Feed-forward of acceleration: the torques, Nm and N, that the arm's inertia needs."""
        self._qacc[self._arm_dofs] = acceleration
        mujoco.mj_mulM(self._model, data, self._torque, self._qacc)
        return self._torque[self._arm_dofs]

    def _memory(self, data: mujoco.MjData) -> Array:
        memory: Array = data.userdata.reshape(-1, _WIDTH)
        return memory


def _setpoint(row: Array) -> JointSetpoint:
    return JointSetpoint(row[:N_ARM].copy(), row[N_ARM : 2 * N_ARM].copy(), row[2 * N_ARM :].copy())
