"""A complete driver: a simulated gantry with three linear axes that follow exactly."""

from __future__ import annotations

import numpy as np

import iher_robot

KINEMATICS = """<mujoco>
  <default><joint type="slide" range="0 1"/></default>
  <worldbody><body>
    <joint name="x" axis="1 0 0"/> <joint name="y" axis="0 1 0"/> <joint name="z" axis="0 0 1"/>
    <geom size="0.01"/> <site name="ee"/>
  </body></worldbody>
</mujoco>"""
AXIS = iher_robot.JointLimits(lower=0.0, upper=1.0, max_velocity=1.0, max_acceleration=10.0)
SPEC = iher_robot.RobotSpec(
    name="line",
    command_kinds=("joint",),
    action=iher_robot.ActionSpec(position_scale_m=0.03, gripper_scale_m=0.004),
    control_period_s=0.04,
    frame="world",
    objects={},
    finger_names=("right", "left"),
    limits=iher_robot.Limits(
        joints={"x": AXIS, "y": AXIS, "z": AXIS},
        gripper=iher_robot.GripperLimits(lower_m=0.0, upper_m=0.05, max_speed_m_s=0.1),
        max_ee_speed_m_s=1.0,
        workspace=iher_robot.Box((0.1, 0.1, 0.1), (0.9, 0.9, 0.9)),
        watchdog_s=0.1,
    ),
    gains={},
    calibration_id="simulated",
    kinematic_model=KINEMATICS,
    home=iher_robot.Home((0.5, 0.5, 0.5), (1.0, 0.0, 0.0, 0.0), q=(0.5, 0.5, 0.5)),
    physical=False,
    hold_on_silence_s=None,
    enforces_joint_limits=True,
)


class LineRobot(iher_robot.RobotDriver):
    """A robot that is always at its setpoint, which the safety filter keeps within the limits."""

    def __init__(self, *, scene: str = "reach") -> None:
        if scene != "reach":
            raise iher_robot.InvalidRequest(f"scene of 'line' is {scene!r}, allowed: 'reach'")
        self._time = iher_robot.SimulatedClock()
        super().__init__(SPEC, self._time)
        self._seq = 0
        self._begin_at_home()

    def _begin_at_home(self) -> None:
        self._setpoint = iher_robot.JointSetpoint(np.array(SPEC.home.q), np.zeros(3), np.zeros(2))
        self._fingers_vel = np.zeros(2)
        self._pending: tuple[iher_robot.Command, tuple[str, ...]] | None = None
        self._applied: iher_robot.AppliedCommand | None = None

    def _open(self) -> None:
        """Do nothing: there is no connection."""

    def _close(self) -> None:
        """Do nothing: there is no connection."""

    def _hold(self) -> None:
        self._pending = None  # the next tick brakes

    def _apply(self, command: iher_robot.Command, clipped: tuple[str, ...]) -> None:
        self._pending = (command, clipped)

    def _advance(self) -> None:
        self._seq += 1
        self._time.advance_ns(SPEC.control_period_ns)
        before = self._setpoint
        if self._pending is None:
            self._setpoint = self._brake(before)
        else:
            command, clipped = self._pending
            assert isinstance(command, iher_robot.JointCommand)
            q, dq, fingers = command.q_target, command.dq, command.finger_target
            self._setpoint = iher_robot.JointSetpoint(q, dq, fingers)
            self._applied = iher_robot.AppliedCommand(self._seq, command, clipped)
        self._pending = None
        self._fingers_vel = (self._setpoint.fingers - before.fingers) / SPEC.control_period_s

    def _reset(self, request: iher_robot.ResetRequest) -> iher_robot.ResetResult:
        """Go home. The spec declares no objects, and the base class refuses unknown ones."""
        del request
        self._seq += 1
        self._time.advance_ns(SPEC.control_period_ns)
        self._begin_at_home()
        return iher_robot.ResetResult(iher_robot.ResetOutcome.DONE)

    def _read(self) -> iher_robot.RobotState:
        at = self._setpoint
        return iher_robot.RobotState(
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
