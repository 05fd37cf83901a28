"""The simulated Fetch robot, with the physics of gymnasium-robotics' ``Fetch*-v4``."""

from __future__ import annotations

import copy
import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray

from drivers.clipping import clip_displacement
from drivers.clock import SimulatedClock
from drivers.command import (
    Command,
    EndEffectorCommand,
    ResetOutcome,
    ResetRequest,
    ResetResult,
)
from drivers.driver import RobotDriver
from drivers.errors import UnknownDriver
from drivers.mujoco.fetch_spec import FINGERS, fetch_spec
from drivers.mujoco.measure import Sensors
from drivers.mujoco.picture import Camera
from drivers.mujoco.requests import object_places, require_same_model
from drivers.mujoco.scene import POINTING_DOWN, SUBSTEPS, find_scene, load_model, settle
from drivers.names import unknown
from drivers.state import AppliedCommand, RobotState

ACTUATIONS = ("mocap",)


class MujocoDriver(RobotDriver):
    """A Fetch robot in MuJoCo, dragged by a mocap body.

    Nothing enforces joint limits in this actuation: it is for benchmarks in simulation. Its
    clock is simulated, so that a pause never makes a state stale.
    """

    def __init__(self, scene: str = "push", actuation: str = "mocap") -> None:
        """Compile a scene and find where its episodes start.

        Args:
            scene: ``"reach"``, ``"push"``, ``"pick_and_place"`` or ``"slide"``.
            actuation: ``"mocap"``.

        Raises:
            UnknownDriver: If there is no such scene or actuation.
        """
        if actuation not in ACTUATIONS:
            raise UnknownDriver(unknown("actuation of driver 'mujoco':", actuation, ACTUATIONS))
        self._scene = find_scene(scene)
        self._model = load_model(self._scene)
        self._start = settle(self._model, self._scene)
        self._sim_clock = SimulatedClock()
        super().__init__(fetch_spec(self._model, scene, self._scene, self._start), self._sim_clock)
        self._data = mujoco.MjData(self._model)
        self._sensors = Sensors(self._model, self.spec)
        self._camera: Camera | None = None
        self._gripper = self._model.body("robot0:gripper_link").id
        self._finger_qpos = [int(self._model.joint(name).qposadr[0]) for name in FINGERS]
        # Actuators come in an order of their own: for each, its joint and its finger.
        driven = [int(joint) for joint in self._model.actuator_trnid[:, 0]]
        self._actuated_qpos = self._model.jnt_qposadr[driven]
        self._actuated_finger = [FINGERS.index(self._model.joint(joint).name) for joint in driven]
        self._seq = 0
        self._pending: EndEffectorCommand | None = None
        self._holding = False
        self._applied: AppliedCommand | None = None
        self._measured: RobotState | None = None

    def snapshot(self) -> mujoco.MjData:
        """Return an exact copy of the simulation; `mj_getState` would lose what actions read."""
        with self._hooks:
            return copy.copy(self._data)

    def restore(self, data: mujoco.MjData) -> None:
        """Continue from a snapshot, or from a simulation of the same model elsewhere.

        States read before are no longer answerable, as after a reset.

        Args:
            data: Copied, not kept.

        Raises:
            LifecycleError: If the driver is not open.
            InvalidRequest: If the data belong to another model.
        """
        with self._hooks:
            self._require_open("restore")
            require_same_model(self._model, data, self.spec.name)
            self._hold()
            self._gate.forget_states()
            self._data = copy.copy(data)
            self._begin_anew()

    def render(
        self, width: int, height: int, goal: NDArray[np.float64] | None = None
    ) -> NDArray[np.uint8]:
        """Return a picture of the scene. The environment variable MUJOCO_GL must be set.

        Args:
            width: Pixels.
            height: Pixels.
            goal: Marked in red, world frame, m. ``(3,)``

        Returns:
            RGB. ``(height, width, 3)``
        """
        with self._hooks:
            if self._camera is None or self._camera.size != (width, height):
                if self._camera is not None:
                    self._camera.close()
                self._camera = Camera(self._model, width, height)
            return self._camera.take(self._data, goal)

    def _open(self) -> None:
        self._restore_start({})
        self._hold()

    def _close(self) -> None:
        if self._camera is not None:
            self._camera.close()
            self._camera = None

    def _hold(self) -> None:
        self._pending = None

    def _read(self) -> RobotState:
        moving = self._applied is not None and self._applied.tick == self._seq
        mode = self._mode(moving)
        fault = None if self.fault is None else self.fault.name
        measured = self._measured
        if measured is None:
            now_ns = self._sim_clock.now_ns()
            measured = self._sensors.read(self._data, self._seq, now_ns, mode, fault, self._applied)
            self._measured = measured
        elif (measured.mode, measured.fault) != (mode, fault):
            measured = dataclasses.replace(measured, mode=mode, fault=fault)
            self._measured = measured
        return measured

    def _apply(self, command: Command) -> None:
        assert isinstance(command, EndEffectorCommand)
        self._pending = command

    def _advance(self) -> None:
        command = self._pending
        self._pending = None
        self._seq += 1
        self._measured = None
        if command is not None:
            command, clipped = clip_displacement(command, self.spec.action)
            self._aim(command.delta_pos, command.finger_delta)
            self._holding = False
            self._applied = AppliedCommand(self._seq, command, clipped)
        elif not self._holding:  # once: aiming anew at every tick would drift with the sag
            self._aim(np.zeros(3), np.zeros(len(FINGERS)))
            self._holding = True
        mujoco.mj_step(self._model, self._data, nstep=SUBSTEPS)
        if self._scene.locked_fingers:
            # Without this scene property the sites lag the joints by a sub-step, as they do
            # in the reference (MujocoFetchEnv._step_callback).
            self._data.qpos[self._finger_qpos] = 0.0
            mujoco.mj_forward(self._model, self._data)
        self._sim_clock.advance_ns(self.spec.control_period_ns)

    def _aim(self, delta_pos: NDArray[np.float64], finger_delta: NDArray[np.float64]) -> None:
        # Relative to where the body *is*, so that an action of 1 moves about 33 of its 50 mm.
        data = self._data
        data.mocap_pos[0] = data.xpos[self._gripper] + delta_pos
        data.mocap_quat[0] = data.xquat[self._gripper] + POINTING_DOWN
        if self._model.nu:
            data.ctrl[:] = data.qpos[self._actuated_qpos] + finger_delta[self._actuated_finger]

    def _reset(self, request: ResetRequest) -> ResetResult:
        self._restore_start(object_places(request, self.spec))
        return ResetResult(ResetOutcome.DONE)

    def _restore_start(self, places: dict[str, NDArray[np.float64]]) -> None:
        mujoco.mj_resetData(self._model, self._data)
        self._data.time = self._start.time
        self._data.qpos[:] = self._start.qpos
        self._data.qvel[:] = self._start.qvel
        for name, place in places.items():
            address = self._model.joint(f"{name}:joint").qposadr[0]
            self._data.qpos[address : address + 2] = place
        mujoco.mj_forward(self._model, self._data)
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._seq += 1
        self._sim_clock.advance_ns(self.spec.control_period_ns)
        self._applied = None
        self._holding = False
        self._measured = None
