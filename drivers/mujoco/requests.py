"""Checks of reset requests to the simulated robot, and of simulations to restore."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from drivers.command import ResetRequest
from drivers.errors import InvalidRequest
from drivers.spec import RobotSpec

_NEAREST_M = (0.1, -0.3)
_FARTHEST_M = (2.3, 1.8)
"""Range of an object's start: tables reach at most half a metre beyond the arm."""

_SIZES = tuple(
    "nq nv nu na nbody njnt ngeom nsite nmocap neq ntendon nsensordata nuserdata".split()
)
# These differ between scenes, but not between robots in the same scene.
_CONSTANTS = ("qpos0", "body_mass", "geom_size", "geom_friction")


def object_places(request: ResetRequest, spec: RobotSpec) -> dict[str, NDArray[np.float64]]:
    """Return the requested places of the objects, in the spec's frame, m. Each ``(2,)``

    Args:
        request: The request.
        spec: The robot.

    Raises:
        InvalidRequest: If a place is invalid, or outside of the table.
    """
    return {name: _place(name, place, spec) for name, place in request.objects.items()}


def _place(name: str, asked: object, spec: RobotSpec) -> NDArray[np.float64]:
    try:
        place = np.array(asked, dtype=np.float64)
    except (TypeError, ValueError):
        place = np.empty(0)  # not numbers: the same message
    if place.shape != (2,) or not _on_a_table(place):
        raise InvalidRequest(
            f"reset of {spec.name} places {name!r} at {asked!r}, allowed: "
            f"(x, y) from {_NEAREST_M} to {_FARTHEST_M} m"
        )
    return place


def _on_a_table(place: NDArray[np.float64]) -> bool:
    inside = (np.array(_NEAREST_M) <= place) & (place <= np.array(_FARTHEST_M))
    return bool(inside.all())  # False for nan


def require_same_model(model: mujoco.MjModel, data: object, name: str) -> None:
    """Check that a simulation to be restored has the driver's model.

    Args:
        model: The driver's model.
        data: The simulation.
        name: Name of the robot, for the message.

    Raises:
        InvalidRequest: If sizes, masses or shapes differ.
    """
    if not isinstance(data, mujoco.MjData):
        raise InvalidRequest(f"restore on {name} got a {type(data).__name__}, allowed: MjData")
    for size in _SIZES:
        found, own = getattr(data.model, size), getattr(model, size)
        if found != own:
            raise InvalidRequest(
                f"restore on {name} got data of another model: {size} is {found}, allowed: {own}"
            )
    for constant in _CONSTANTS:
        if not np.array_equal(getattr(data.model, constant), getattr(model, constant)):
            raise InvalidRequest(
                f"restore on {name} got data of another model: {constant} differs, "
                "allowed: data of the same scene"
            )
