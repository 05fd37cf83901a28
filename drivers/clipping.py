"""Cuts displacements to what an action can ask for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.command import EndEffectorCommand
from drivers.spec import ActionSpec

POSITION_SCALE = "position_scale"
GRIPPER_SCALE = "gripper_scale"

# An action of 1 in single precision, times the scale, exceeds the scale by half a last bit.
_ROUNDING = 1e-6


def clip_displacement(
    command: EndEffectorCommand, action: ActionSpec
) -> tuple[EndEffectorCommand, tuple[str, ...]]:
    """Cut a displacement to the scales of the action, as a whole: its direction stays.

    Args:
        command: What was asked.
        action: The scales; they bound each component, as the action space does.

    Returns:
        What to apply, the very same command if nothing exceeds, and why it differs.
    """
    delta_pos = _shrink(command.delta_pos, action.position_scale_m)
    finger_delta = _shrink(command.finger_delta, action.gripper_scale_m)
    clipped = []
    if delta_pos is not command.delta_pos:
        clipped.append(POSITION_SCALE)
    if finger_delta is not command.finger_delta:
        clipped.append(GRIPPER_SCALE)
    if not clipped:
        return command, ()
    return EndEffectorCommand(command.answers, delta_pos, finger_delta), tuple(clipped)


def _shrink(delta: NDArray[np.float64], limit: float) -> NDArray[np.float64]:
    greatest = float(np.abs(delta).max(initial=0.0))
    if greatest <= limit * (1.0 + _ROUNDING):
        return delta  # untouched: scaling would cost the last bits
    return delta / greatest * limit
