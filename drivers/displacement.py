"""Limits of end-effector displacements: the action's scale, the speed and the allowed region."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.command import EndEffectorCommand
from drivers.reasons import Clip
from drivers.region import Region
from drivers.spec import RobotSpec

Array = NDArray[np.float64]


# An action of 1 in single precision, times the scale, can exceed the scale by half a last bit.
_ROUNDING = 1e-6
_BISECTIONS = 20
_NO_GUARDS = np.zeros(0)


class DisplacementLimit:
    """Scales displacements down to the limits of a robot; their direction stays."""

    def __init__(self, spec: RobotSpec) -> None:
        """Set the limits up.

        Args:
            spec: The robot.
        """
        self._action = spec.action
        self._most_m = spec.limits.max_ee_speed_m_s * spec.control_period_s
        self._region = Region(spec.limits)

    def limit(
        self, command: EndEffectorCommand, ee_pos: Array, speed_scale: float
    ) -> tuple[EndEffectorCommand, tuple[Clip, ...]]:
        """Limit a displacement.

        Args:
            command: The requested displacement.
            ee_pos: Position of the end effector, m. ``(3,)``
            speed_scale: Share of full speed that is allowed, in (0, 1].

        Returns:
            The command to apply, the same object if it exceeds no limit, and why it differs.
        """
        reasons: list[Clip] = []
        # The scales bound each component, as the action space does.
        delta_pos = _shrink(command.delta_pos, self._action.position_scale_m)
        if delta_pos is not command.delta_pos:
            reasons.append(Clip.POSITION_SCALE)
        fingers = _shrink(command.finger_delta, self._action.gripper_scale_m * speed_scale)
        if fingers is not command.finger_delta:
            reasons.append(Clip.GRIPPER_SCALE)
        distance, most_m = float(np.linalg.norm(delta_pos)), self._most_m * speed_scale
        if distance > most_m * (1.0 + _ROUNDING):
            reasons.append(Clip.EE_SPEED)
            delta_pos = delta_pos * (most_m / distance)
        broken = self._broken(ee_pos, delta_pos)
        if broken:
            reasons.extend(broken)
            delta_pos = self._largest_allowed(ee_pos, delta_pos)
        if not reasons:
            return command, ()
        return EndEffectorCommand(command.answers, delta_pos, fingers), tuple(reasons)

    def _largest_allowed(self, ee_pos: Array, delta_pos: Array) -> Array:
        low, high = 0.0, 1.0
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2.0
            if self._broken(ee_pos, middle * delta_pos):
                high = middle
            else:
                low = middle
        return low * delta_pos

    def _broken(self, ee_pos: Array, delta_pos: Array) -> list[Clip]:
        now = self._region.depths(ee_pos[None], _NO_GUARDS)
        then = self._region.depths((ee_pos + delta_pos)[None], _NO_GUARDS)
        return self._region.exceeded(then, now, slack=0.0)


def _shrink(delta: Array, limit: float) -> Array:
    greatest = float(np.abs(delta).max(initial=0.0))
    if greatest <= limit * (1.0 + _ROUNDING):
        return delta  # untouched: scaling would cost the last bits
    return delta / greatest * limit
