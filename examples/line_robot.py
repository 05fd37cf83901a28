"""A complete driver: a simulated gantry of three straight axes, which follows exactly."""

from __future__ import annotations

import numpy as np

import drivers

KINEMATICS = """<mujoco>
  <default><joint type="slide" range="0 1"/></default>
  <worldbody><body>
    <joint name="x" axis="1 0 0"/> <joint name="y" axis="0 1 0"/> <joint name="z" axis="0 0 1"/>
    <geom size="0.01"/> <site name="ee"/>
  </body></worldbody>
</mujoco>"""
AXIS = drivers.JointLimits(lower=0.0, upper=1.0, max_velocity=1.0, max_acceleration=10.0)
SPEC = drivers.RobotSpec(
    name="line",
    command_kinds=("joint",),
    action=drivers.ActionSpec(position_scale_m=0.03, gripper_scale_m=0.004),
    control_period_s=0.04,
    frame="world",
    objects={},
    finger_names=("right", "left"),
    limits=drivers.Limits(
        joints={"x": AXIS, "y": AXIS, "z": AXIS},
        gripper=drivers.GripperLimits(lower_m=0.0, upper_m=0.05, max_speed_m_s=0.1),
        max_ee_speed_m_s=1.0,
        workspace=drivers.Box((0.1, 0.1, 0.1), (0.9, 0.9, 0.9)),
        watchdog_s=0.1,
    ),
    gains={},
    calibration_id="simulated",
    kinematic_model=KINEMATICS,
    home=drivers.Home((0.5, 0.5, 0.5), (1.0, 0.0, 0.0, 0.0), q=(0.5, 0.5, 0.5)),
    physical=False,
    hold_on_silence_s=None,
    enforces_joint_limits=True,
)


class LineRobot(drivers.RobotDriver):
    """Is always where its setpoint is, and the safety filter has cut that to every limit."""

    def __init__(self, *, scene: str = "reach") -> None:
        if scene != "reach":
            raise drivers.InvalidRequest(f"scene of 'line' is {scene!r}, allowed: 'reach'")
        self._time = drivers.SimulatedClock()
        super().__init__(SPEC, self._time)
        self._seq = 0
        self._begin_at_home()

    def _begin_at_home(self) -> None:
        self._setpoint = drivers.JointSetpoint(np.array(SPEC.home.q), np.zeros(3), np.zeros(2))
        self._fingers_vel = np.zeros(2)
        self._pending: tuple[drivers.Command, tuple[str, ...]] | None = None
        self._applied: drivers.AppliedCommand | None = None

    def _open(self) -> None:
        """There is nothing to connect to."""

    def _close(self) -> None:
        """There is nothing to disconnect from."""

    def _hold(self) -> None:
        self._pending = None  # the next tick brakes

    def _apply(self, command: drivers.Command, clipped: tuple[str, ...]) -> None:
        self._pending = (command, clipped)

    def _advance(self) -> None:
        self._seq += 1
        self._time.advance_ns(SPEC.control_period_ns)
        before = self._setpoint
        if self._pending is None:
            self._setpoint = self._brake(before)
        else:
            command, clipped = self._pending
            assert isinstance(command, drivers.JointCommand)
            q, dq, fingers = command.q_target, command.dq, command.finger_target
            self._setpoint = drivers.JointSetpoint(q, dq, fingers)
            self._applied = drivers.AppliedCommand(self._seq, command, clipped)
        self._pending = None
        self._fingers_vel = (self._setpoint.fingers - before.fingers) / SPEC.control_period_s

    def _reset(self, request: drivers.ResetRequest) -> drivers.ResetResult:
        if request.objects:
            raise drivers.InvalidRequest(f"'line' has no objects, got {sorted(request.objects)}")
        self._seq += 1
        self._time.advance_ns(SPEC.control_period_ns)
        self._begin_at_home()
        return drivers.ResetResult(drivers.ResetOutcome.DONE)

    def _read(self) -> drivers.RobotState:
        at = self._setpoint
        return drivers.RobotState(
            seq=self._seq,
            stamp_ns=self._time.now_ns(),
            q=at.q,
            dq=at.dq,
            ee_pos=at.q,
            ee_quat=np.array(SPEC.home.ee_quat),
            ee_linvel=at.dq,
            ee_angvel=np.zeros(3),
            fingers_pos=at.fingers,
            fingers_vel=self._fingers_vel,
            mode=self._mode(self._applied is not None and self._applied.tick == self._seq),
            fault=None if self.fault is None else self.fault.name,
            applied=self._applied,
            objects={},
            setpoint=at,
        )
