"""Limits of joint commands: each tick stays within every limit, and leaves room to stop.

Within a tick a joint's acceleration is constant: from ``(q0, dq0)`` it gets to ``(q1, dq1)``
with ``q1 = q0 + (dq0 + dq1) / 2 * T``. So speed and acceleration at the ends of ticks bound
them everywhere, and ``dq1`` is the only free variable of a tick.

Braking brings all joints to rest together, on a straight line in joint space, as fast as the
slowest joint allows. A motion is allowed only if braking after it would stay within every limit.
Braking is then allowed in every tick, and a motion that breaks a limit is blended towards it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from drivers.command import JointCommand
from drivers.kinematics import Kinematics
from drivers.reasons import Clip
from drivers.region import Region
from drivers.spec import RobotSpec
from drivers.state import JointSetpoint

Array = NDArray[np.float64]


_BISECTIONS = 7
_FEWEST_POINTS = 3
_HUGE = 1e9
# Limits are met to this share of themselves, so that a motion at the limit is not cut again
# in its next tick for the last bits.
_ROUNDING = 1e-9


class JointMotion:
    """Limits joint commands to what a robot allows."""

    def __init__(self, spec: RobotSpec) -> None:
        """Set the limits up.

        Args:
            spec: The robot.

        Raises:
            InvalidSpec: If its kinematic model cannot be used.
        """
        joints = spec.limits.joints.values()
        self._lower = np.array([joint.lower for joint in joints])
        self._upper = np.array([joint.upper for joint in joints])
        self._speed = np.array([joint.max_velocity for joint in joints])
        self._acceleration = np.array([joint.max_acceleration for joint in joints])
        self._ee_speed = spec.limits.max_ee_speed_m_s
        self._gripper = spec.limits.gripper
        self._region = Region(spec.limits)
        self._period_s = spec.control_period_s
        self._kinematics = Kinematics(spec)

    def limit(
        self, command: JointCommand, start: JointSetpoint, speed_scale: float
    ) -> tuple[JointCommand, tuple[Clip, ...]]:
        """Limit the motion of the next tick.

        Args:
            command: The requested motion.
            start: The current setpoint.
            speed_scale: Share of full speed that is allowed, in (0, 1].

        Returns:
            The motion of the next tick, its end and the velocity there, and why it differs from
            the requested one.
        """
        reasons: list[Clip] = []
        asked = self._asked_velocity(command, start)
        dq = self._within_speeds(asked, start.q, speed_scale, reasons)
        dq = self._reachable(dq, start, speed_scale, reasons)
        fingers = self._fingers(command.finger_target, start.fingers, speed_scale, reasons)
        q = self._end(start, dq)
        return JointCommand(command.answers, q, dq, self._period_s, fingers), tuple(reasons)

    def brake(self, start: JointSetpoint) -> JointSetpoint:
        """Return the setpoint at the end of a tick of braking; at rest it stays the same.

        Args:
            start: The current setpoint.
        """
        dq = self._braked(start.dq)
        return JointSetpoint(self._end(start, dq), dq, start.fingers.copy())

    def _asked_velocity(self, command: JointCommand, start: JointSetpoint) -> Array:
        # With a matching dq the tick ends at the target, up to rounding; a target that is repeated
        # with dq = 0 is reached, at rest, in two ticks.
        duration_s = max(command.duration_s, self._period_s)
        # Clipped, since the difference of two huge finite numbers can be infinite.
        q_target, dq = (np.clip(asked, -_HUGE, _HUGE) for asked in (command.q_target, command.dq))
        at_end = (q_target - start.q) / duration_s + (dq - start.dq) / 2.0
        velocity: Array = start.dq + (at_end - start.dq) * (self._period_s / duration_s)
        return velocity

    def _within_speeds(self, dq: Array, q: Array, scale: float, reasons: list[Clip]) -> Array:
        """Slow down the motion as a whole: joint by joint would bend its path."""
        excess = float((np.abs(dq) / (self._speed * scale)).max())
        if excess > 1.0 + _ROUNDING:
            reasons.append(Clip.JOINT_SPEED)
            dq = dq / excess
        speed = float(np.linalg.norm(self._kinematics.ee_jacobian(q) @ dq))
        if speed > self._ee_speed * scale * (1.0 + _ROUNDING):
            reasons.append(Clip.EE_SPEED)
            dq = dq * (self._ee_speed * scale / speed)
        return dq

    def _reachable(
        self, dq: Array, start: JointSetpoint, scale: float, reasons: list[Clip]
    ) -> Array:
        """Limit the acceleration, then blend towards braking until no limit is broken."""
        change = dq - start.dq
        excess = float((np.abs(change) / (self._acceleration * self._period_s)).max())
        if excess > 1.0 + _ROUNDING:
            reasons.append(Clip.JOINT_ACCELERATION)
            dq = start.dq + change / excess
        allowed = self._depths(start.q)
        broken = self._broken(dq, start, allowed, scale)
        if not broken:
            return dq
        reasons.extend(reason for reason in broken if reason not in reasons)
        braked = self._braked(start.dq)
        low, high = 0.0, 1.0
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2.0
            if self._broken(braked + middle * (dq - braked), start, allowed, scale):
                high = middle
            else:
                low = middle
        return braked + low * (dq - braked)

    def _broken(
        self, dq: Array, start: JointSetpoint, allowed: dict[Clip, Array], scale: float
    ) -> tuple[Clip, ...]:
        """Return the limits that a tick ending at `dq`, and braking after it, would break."""
        q = self._end(start, dq)
        ticks = self._braking_ticks(dq)
        rest = q + dq * ticks * self._period_s / 2.0
        broken: list[Clip] = []
        # From outside a limit, motion may not go further out, but may come back.
        lower, upper = np.minimum(self._lower, start.q), np.maximum(self._upper, start.q)
        if (np.minimum(q, rest) < lower).any() or (np.maximum(q, rest) > upper).any():
            broken.append(Clip.JOINT_RANGE)
        speed = float(np.linalg.norm(self._kinematics.ee_jacobian(q) @ dq))
        if speed > self._ee_speed * scale * (1.0 + _ROUNDING):
            broken.append(Clip.EE_SPEED)
        # Half-way through the tick, then along the braking path, in steps of at most a tick.
        half_way = start.q + (3.0 * start.dq + dq) / 8.0 * self._period_s
        shares = np.linspace(0.0, 1.0, 1 + max(_FEWEST_POINTS, ticks))
        for point in (half_way, *(q + share * (rest - q) for share in shares)):
            broken += self._region.exceeded(self._depths(point), allowed, slack=_ROUNDING)
        return tuple(dict.fromkeys(broken))

    def _depths(self, q: Array) -> dict[Clip, Array]:
        points = self._kinematics.guarded_points(q)
        return self._region.depths(points, self._kinematics.guard_radii)

    def _braking_ticks(self, dq: Array) -> int:
        # Rounding of a motion that just fits must not cost an additional tick.
        ticks = float((np.abs(dq) / (self._acceleration * self._period_s)).max())
        return math.ceil(ticks * (1.0 - _ROUNDING) - _ROUNDING)

    def _braked(self, dq: Array) -> Array:
        ticks = self._braking_ticks(dq)
        return dq * (1.0 - 1.0 / ticks) if ticks > 1 else np.zeros_like(dq)

    def _end(self, start: JointSetpoint, dq: Array) -> Array:
        q: Array = start.q + (start.dq + dq) / 2.0 * self._period_s
        return q

    def _fingers(self, target: Array, now: Array, scale: float, reasons: list[Clip]) -> Array:
        limits = self._gripper
        within = np.clip(target, limits.lower_m, limits.upper_m)
        if (within != target).any():
            reasons.append(Clip.FINGER_RANGE)
        step = limits.max_speed_m_s * scale * self._period_s
        change = np.clip(within - now, -step, step)
        if (np.abs(within - now) > step * (1.0 + _ROUNDING)).any():
            reasons.append(Clip.FINGER_SPEED)
        fingers: Array = now + change
        return fingers
