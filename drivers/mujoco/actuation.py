"""Actuation of the simulated robot: the interface, and actuation by a mocap body."""

from __future__ import annotations

from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from drivers.command import Command, EndEffectorCommand
from drivers.mujoco.fetch_spec import FINGERS
from drivers.mujoco.scene import POINTING_DOWN, SUBSTEPS
from drivers.state import JointSetpoint


class Actuation(Protocol):
    """Runs one control tick of physics with a command."""

    def begin(self, data: mujoco.MjData) -> None:
        """Hold the robot in a simulation that was just reset."""
        ...

    def resume(self, data: mujoco.MjData) -> None:
        """Continue with a simulation that was restored."""
        ...

    def tick(self, data: mujoco.MjData, command: Command | None) -> None:
        """Run one control tick; without a command the robot comes to rest.

        Args:
            data: The simulation, stepped in place.
            command: Within every limit.
        """
        ...

    def setpoint(self, data: mujoco.MjData) -> JointSetpoint | None:
        """Return the setpoint, None if the robot takes no joint commands."""
        ...


class MocapActuation:
    """A mocap body, welded to the gripper, drags the arm along. Joint limits are not enforced.

    Source: ``_set_action`` and ``_step_callback`` of `gymnasium_robotics/envs/fetch_env.py`.
    """

    def __init__(self, model: mujoco.MjModel, locked_fingers: bool) -> None:
        """Look up the indices of gripper and fingers.

        Args:
            model: The compiled scene.
            locked_fingers: Whether the fingers are kept closed.
        """
        self._model = model
        self._locked_fingers = locked_fingers
        self._gripper = model.body("robot0:gripper_link").id
        self._finger_qpos = [int(model.joint(name).qposadr[0]) for name in FINGERS]
        # Of each actuator, whose order is not that of the fingers: its joint and its finger.
        driven = [int(joint) for joint in model.actuator_trnid[:, 0]]
        self._actuated_qpos = model.jnt_qposadr[driven]
        self._actuated_finger = [FINGERS.index(model.joint(joint).name) for joint in driven]
        self._holding = False

    def begin(self, data: mujoco.MjData) -> None:  # noqa: ARG002 - a tick aims the mocap body
        """Hold the robot from the next tick on."""
        self._holding = False

    def resume(self, data: mujoco.MjData) -> None:  # noqa: ARG002 - as in `begin`
        """Continue with a simulation that was restored."""
        self._holding = False

    def tick(self, data: mujoco.MjData, command: Command | None) -> None:
        """Drag the gripper towards its displaced position for one control tick."""
        if command is not None:
            assert isinstance(command, EndEffectorCommand)
            self._aim(data, command.delta_pos, command.finger_delta)
            self._holding = False
        elif not self._holding:  # once: aiming again in every tick would drift with the sag
            self._aim(data, np.zeros(3), np.zeros(len(FINGERS)))
            self._holding = True
        mujoco.mj_step(self._model, data, nstep=SUBSTEPS)
        if self._locked_fingers:
            # Without this scene property the sites lag the joints by a sub-step, as they do
            # in the reference.
            data.qpos[self._finger_qpos] = 0.0
            mujoco.mj_forward(self._model, data)

    def setpoint(self, data: mujoco.MjData) -> JointSetpoint | None:  # noqa: ARG002
        """Return None: there are no motors."""
        return None

    def _aim(
        self, data: mujoco.MjData, delta_pos: NDArray[np.float64], finger_delta: NDArray[np.float64]
    ) -> None:
        # Relative to the body's current position, so that an action of 1 moves it by 33 of 50 mm.
        data.mocap_pos[0] = data.xpos[self._gripper] + delta_pos
        data.mocap_quat[0] = data.xquat[self._gripper] + POINTING_DOWN
        if self._model.nu:
            data.ctrl[:] = data.qpos[self._actuated_qpos] + finger_delta[self._actuated_finger]
