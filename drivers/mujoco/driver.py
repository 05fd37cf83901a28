"""Driver of the simulated Fetch robot, with the physics of gymnasium-robotics' ``Fetch*-v4``."""

from __future__ import annotations

import copy
import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray

from drivers.clock import SimulatedClock
from drivers.command import Command, ResetOutcome, ResetRequest, ResetResult
from drivers.driver import RobotDriver
from drivers.mujoco.actuation import Actuation, MocapActuation
from drivers.mujoco.compiled import compile_scene
from drivers.mujoco.fetch_spec import fetch_spec
from drivers.mujoco.measure import Sensors
from drivers.mujoco.picture import Pictures
from drivers.mujoco.requests import object_places, require_same_model
from drivers.mujoco.robot import FetchRobot, fetch_robot
from drivers.mujoco.scene import find_scene
from drivers.mujoco.servo import JointActuation
from drivers.state import AppliedCommand, RobotState


class MujocoDriver(RobotDriver):
    """A Fetch robot in MuJoCo.

    In ``joint`` actuation motors move its joints, within the limits of the real robot. In
    ``mocap`` actuation a mocap body drags the gripper along, as in gymnasium-robotics'
    environments, and joint limits are not enforced: for benchmarks in simulation only.

    The clock is simulated, so that a pause never makes a state stale.
    """

    def __init__(self, scene: str = "push", robot: FetchRobot | None = None) -> None:
        """Compile a scene and compute its start state.

        Args:
            scene: ``"reach"``, ``"push"``, ``"pick_and_place"`` or ``"slide"``.
            robot: Parameters of the robot.

        Raises:
            UnknownDriver: If there is no such scene.
        """
        self._robot = FetchRobot() if robot is None else robot
        fetch_scene = find_scene(scene)
        compiled = compile_scene(scene, self._robot)
        self._model, self._start = compiled.model, compiled.start
        self._actuation: Actuation
        if self._robot.actuation == "mocap":
            self._actuation = MocapActuation(self._model, fetch_scene.locked_fingers)
        else:
            self._actuation = JointActuation(self._model, self._brake)
        self._sim_clock = SimulatedClock()
        spec = fetch_spec(
            self._model, scene, fetch_scene, self._start, self._robot, compiled.kinematics
        )
        super().__init__(spec, self._sim_clock)
        self._data = mujoco.MjData(self._model)
        self._sensors = Sensors(self._model, self.spec, self._robot.sensors)
        self._pictures = Pictures(self._model)
        self._seq = 0
        self._pending: tuple[Command, tuple[str, ...]] | None = None
        self._applied: AppliedCommand | None = None
        self._measured: RobotState | None = None

    def snapshot(self) -> mujoco.MjData:
        """Return an exact copy of the simulation; `mj_getState` lacks data that commands use."""
        with self._hooks:
            return copy.copy(self._data)

    def restore(self, data: mujoco.MjData) -> None:
        """Continue from a snapshot, or from a simulation of the same model elsewhere.

        As after a reset, states read before cannot be answered any more, the camera starts
        without a measurement, and the noise starts from its seed.

        Args:
            data: The simulation, which is copied.

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
            self._actuation.resume(self._data)
            self._begin_anew(seed=0)

    def render(
        self,
        width: int,
        height: int,
        goal: NDArray[np.float64] | None = None,
        reached: bool = False,
    ) -> NDArray[np.uint8]:
        """Return an image of the scene. Without a display MUJOCO_GL must be set.

        Args:
            width: Pixels.
            height: Pixels.
            goal: Marked in red, or in green once it is reached, world frame, m. ``(3,)``
            reached: Whether the goal is reached.

        Returns:
            RGB. ``(height, width, 3)``

        Raises:
            CannotRender: If this machine cannot render.
        """
        with self._hooks:
            return self._pictures.take(self._data, (width, height), goal, reached)

    def show(self, goal: NDArray[np.float64] | None = None, reached: bool = False) -> bool:
        """Update MuJoCo's viewer; the first call opens it, `close` closes it.

        Args:
            goal: Marked in red, or in green once it is reached, world frame, m. ``(3,)``
            reached: Whether the goal is reached.

        Returns:
            Whether the window is still open.

        Raises:
            CannotRender: If no window can be opened.
        """
        with self._hooks:
            return self._pictures.show(self._data, goal, reached)

    def _open(self) -> None:
        self._restore_start({}, seed=0)
        self._hold()

    def _close(self) -> None:
        self._pictures.close()

    def _hold(self) -> None:
        self._pending = None

    def _read(self) -> RobotState:
        assert self._measured is not None, "every tick and every reset measures"
        moving = self._applied is not None and self._applied.tick == self._seq
        mode, fault = self._mode(moving), None if self.fault is None else self.fault.name
        if (self._measured.mode, self._measured.fault) != (mode, fault):
            self._measured = dataclasses.replace(self._measured, mode=mode, fault=fault)
        return self._measured

    def _apply(self, command: Command, clipped: tuple[str, ...]) -> None:
        self._pending = (command, clipped)

    def _advance(self) -> None:
        pending, self._pending = self._pending, None
        self._seq += 1
        command = None
        if pending is not None:
            command, clipped = pending
            self._applied = AppliedCommand(self._seq, command, clipped)
        self._actuation.tick(self._data, command)
        self._sim_clock.advance_ns(self.spec.control_period_ns)
        self._measure()

    def _reset(self, request: ResetRequest) -> ResetResult:
        self._restore_start(object_places(request, self.spec), request.seed)
        return ResetResult(ResetOutcome.DONE)

    def _restore_start(self, places: dict[str, NDArray[np.float64]], seed: int) -> None:
        mujoco.mj_resetData(self._model, self._data)
        self._data.time = self._start.time
        self._data.qpos[:] = self._start.qpos
        self._data.qvel[:] = self._start.qvel
        for name, place in places.items():
            address = self._model.joint(f"{name}:joint").qposadr[0]
            self._data.qpos[address : address + 2] = place
        mujoco.mj_forward(self._model, self._data)
        self._actuation.begin(self._data)
        self._begin_anew(seed)

    def _begin_anew(self, seed: int) -> None:
        self._seq += 1
        self._sim_clock.advance_ns(self.spec.control_period_ns)
        self._applied = None
        self._sensors.begin(seed)
        self._measure()

    def _measure(self) -> None:
        """Measure once per tick, since the camera must also measure in ticks without a read."""
        self._measured = self._sensors.read(
            self._data,
            self._seq,
            self._sim_clock.now_ns(),
            self._mode(self._applied is not None and self._applied.tick == self._seq),
            None if self.fault is None else self.fault.name,
            self._applied,
            self._actuation.setpoint(self._data),
        )


def make_fetch(*, scene: str, **options: object) -> MujocoDriver:
    """Make a simulated Fetch robot; a `drivers.registry.DriverFactory`.

    Args:
        scene: Name of the scene.
        options: As in a file of ``configs/robots``.

    Raises:
        UnknownDriver: If there is no such scene.
        InvalidSpec: If an option is unknown or its value not allowed.
    """
    return MujocoDriver(scene, fetch_robot(options))
