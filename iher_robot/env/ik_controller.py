"""Inverse kinematics controller: end-effector displacements to joint commands, with mink."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import mink
import numpy as np
from numpy.typing import NDArray

from drivers import AppliedCommand, JointCommand, JointSetpoint, Kinematics, RobotSpec, RobotState
from drivers.kinematics import EE_SITE
from iher_robot.env.clearance_limit import APPROACH_GAIN, ClearanceLimit
from iher_robot.errors import NoSolution

Array = NDArray[np.float64]

_POSITION_COST = 1.0
_ORIENTATION_COST = 0.1  # the stretched arm may tilt the gripper to reach further
_POSTURE_COST = 1e-3
_POSTURE_GAIN = 0.1  # with 1 the elbow would swing to its posture within a tick
_DAMPING_COST = 0.015
_MAX_LEAD_M = 0.04
_MARGIN_M = 0.006
_CLEARANCE_M = 0.005
# Joints brake together, the torso in five ticks: a joint at the end of its range stops the rest.
_RANGE_GAIN = 0.2
_OUTSIDE = 1e-6  # rad or m beyond a joint limit that rounding may cause
_SAME_ACTION = 0.02


class JointController:
    """Converts end-effector displacements to joint commands.

    An action of 1 requests a velocity of `ActionSpec.position_scale_m` per tick, to be reached at
    the end of the tick. One step of differential inverse kinematics gives the joint velocities. It
    starts from the setpoint that the robot reports, never from an earlier request. It keeps the
    orientation of home, the velocity limits and ranges of the joints, and the distance to the
    workspace's sides and to keep-out boxes, along which the arm slides. It is stateless between
    ticks.
    """

    kind: ClassVar[str] = JointCommand.kind

    def __init__(self, spec: RobotSpec, blocks_gripper: bool) -> None:
        """Create the controller.

        Args:
            spec: The robot, with a kinematic model.
            blocks_gripper: Whether the task fixes the gripper.

        Raises:
            InvalidSpec: If the kinematic model cannot be used.
        """
        self._spec = spec
        self._blocks_gripper = blocks_gripper
        self._kinematics = Kinematics(spec)
        model = self._kinematics.model
        self._configuration = mink.Configuration(model)
        self._frame = mink.FrameTask(EE_SITE, "site", _POSITION_COST, _ORIENTATION_COST)
        limits = spec.limits.joints
        fastest = max(joint.max_velocity for joint in limits.values())
        # Slow joints are moved little: a torso must not delay a wrist.
        slowness = np.array([(fastest / j.max_velocity) ** 2 for j in limits.values()])
        posture = mink.PostureTask(model, cost=_POSTURE_COST * slowness, gain=_POSTURE_GAIN)
        posture.set_target(np.array(spec.home.q))
        damping = mink.DampingTask(model, cost=_DAMPING_COST * slowness)
        self._tasks = [self._frame, posture, damping]
        self._lower = np.array([joint.lower for joint in limits.values()]) - _OUTSIDE
        self._upper = np.array([joint.upper for joint in limits.values()]) + _OUTSIDE
        # Targets stay slightly inside the workspace's sides: braking bends the path.
        self._nearest = np.array(spec.limits.workspace.lower) + _MARGIN_M
        self._farthest = np.array(spec.limits.workspace.upper) - _MARGIN_M
        # A joint without an entry would have no limit.
        speeds = {name: np.array([joint.max_velocity]) for name, joint in limits.items()}
        joint_limits = [
            mink.ConfigurationLimit(model, gain=_RANGE_GAIN),
            mink.VelocityLimit(model, speeds),
        ]
        # The second allows zero motion: several points that must leave the margin can conflict.
        self._limits = [
            [*joint_limits, ClearanceLimit(spec, self._kinematics, _CLEARANCE_M, retreats)]
            for retreats in (True, False)
        ]

    @property
    def settings(self) -> Mapping[str, bool | int | float | str]:
        """Settings that a policy file records."""
        return {
            "kind": self.kind,
            "blocks_gripper": self._blocks_gripper,
            "orientation_cost": _ORIENTATION_COST,
            "posture_cost": _POSTURE_COST,
            "max_lead_m": _MAX_LEAD_M,
            "clearance_m": _CLEARANCE_M,
            "approach_gain": APPROACH_GAIN,
            "range_gain": _RANGE_GAIN,
        }

    def command(self, action: NDArray[np.floating], state: RobotState) -> JointCommand:
        """Return the joint command for an action.

        Raises:
            NoSolution: If the robot's setpoint is outside a joint limit, or no motion is
                within the limits.
        """
        setpoint = state.setpoint
        assert setpoint is not None, "a robot that accepts joint commands reports its setpoint"
        self._require_inside(setpoint.q)
        dq = self._velocity(action[:3].astype(np.float64), setpoint, state)
        period_s = self._spec.control_period_s
        q_target = setpoint.q + (setpoint.dq + dq) / 2.0 * period_s
        gripper = 0.0 if self._blocks_gripper else float(action[3])
        fingers = setpoint.fingers + gripper * self._spec.action.gripper_scale_m
        limits = self._spec.limits.gripper
        fingers = np.clip(fingers, limits.lower_m, limits.upper_m)  # an end stop is not a fault
        return JointCommand(state.seq, q_target, dq, period_s, fingers)

    def applied_action(
        self, requested: NDArray[np.float32], applied: AppliedCommand, before: RobotState
    ) -> NDArray[np.float32]:
        """Return the action with the velocity at the end of the tick.

        It is the requested one where they agree within the tolerance of the inverse kinematics.
        """
        command = applied.command
        assert isinstance(command, JointCommand)
        assert before.setpoint is not None
        scales = self._spec.action
        ee_velocity = self._kinematics.ee_jacobian(command.q_target) @ command.dq
        moved = ee_velocity * self._spec.control_period_s / scales.position_scale_m
        fingers = command.finger_target - before.setpoint.fingers
        gripper = float(fingers.mean()) / scales.gripper_scale_m
        action = np.clip(np.append(moved, gripper), -1.0, 1.0).astype(np.float32)
        if self._blocks_gripper:
            action[3] = requested[3]  # it moves nothing
        return requested if np.abs(action - requested).max() < _SAME_ACTION else action

    def _velocity(self, action: Array, setpoint: JointSetpoint, state: RobotState) -> Array:
        self._configuration.update(setpoint.q)
        ee_pos = self._kinematics.ee_pos(setpoint.q)
        target = ee_pos + action * self._spec.action.position_scale_m
        target = np.clip(target, self._nearest, self._farthest)
        # At an obstacle the setpoint must not run away from the arm.
        lead = target - state.ee_pos
        distance = float(np.linalg.norm(lead))
        if distance > _MAX_LEAD_M:
            target = state.ee_pos + lead * (_MAX_LEAD_M / distance)
        rotation = mink.SO3(np.array(self._spec.home.ee_quat))
        self._frame.set_target(mink.SE3.from_rotation_and_translation(rotation, target))
        try:
            return self._solve(self._limits[0])
        except mink.NoSolutionFound:
            pass
        try:
            return self._solve(self._limits[1])
        except mink.NoSolutionFound as error:
            raise NoSolution(
                f"no joint motion of {self._spec.name} within its limits follows the action "
                f"{np.round(action, 3).tolist()}; the robot holds"
            ) from error

    def _solve(self, limits: list[mink.Limit]) -> Array:
        period_s = self._spec.control_period_s
        dq = mink.solve_ik(self._configuration, self._tasks, period_s, "daqp", limits=limits)
        return np.asarray(dq, dtype=np.float64)

    def _require_inside(self, q: Array) -> None:
        outside = np.flatnonzero((q < self._lower) | (q > self._upper))
        if outside.size:
            name = self._spec.joint_names[int(outside[0])]
            limits = self._spec.limits.joints[name]
            raise NoSolution(
                f"joint {name} of {self._spec.name} is at {q[outside[0]]:.4f}, allowed: "
                f"{limits.lower} to {limits.upper}; the robot holds: bring it home"
            )
