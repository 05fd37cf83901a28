"""Elements of every view of the simulation: camera, goal mark, updated positions."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from numpy.typing import NDArray

_GOAL_RADIUS_M = 0.02
_GLOW = 0.5  # otherwise both colours are black in the shadow of the gripper
_RED = np.array([1.0, 0.0, 0.0, 1.0], dtype=np.float32)
_GREEN = np.array([0.0, 0.75, 0.2, 1.0], dtype=np.float32)

Goal = NDArray[np.float64] | None


def mark_goal(scene: mujoco.MjvScene, goal: Goal, reached: bool) -> None:
    """Append a ball to a scene at the goal, red until it is reached, then green.

    Args:
        scene: The scene; unchanged if it is full.
        goal: World frame, m; None marks nothing. ``(3,)``
        reached: Whether the goal is reached.
    """
    if goal is None or scene.ngeom >= scene.maxgeom:
        return
    ball = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(
        ball,
        type=int(mujoco.mjtGeom.mjGEOM_SPHERE),
        size=np.full(3, _GOAL_RADIUS_M),
        pos=np.asarray(goal, dtype=np.float64),
        mat=np.eye(3).ravel(),
        rgba=_GREEN if reached else _RED,
    )
    ball.emission = _GLOW
    scene.ngeom += 1


def look(camera: mujoco.MjvCamera) -> None:
    """Place a camera as in gymnasium-robotics' Fetch environments."""
    camera.distance = 2.5
    camera.azimuth = 132.0
    camera.elevation = -14.0
    camera.lookat[:] = (1.3, 0.75, 0.55)


def settled(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjData:
    """Copy a simulation and update its positions, which may lag the joints by a sub-step."""
    copied = copy.copy(data)
    mujoco.mj_forward(model, copied)
    return copied


def in_a_line(error: BaseException) -> str:
    """Return the message of an error without line breaks."""
    return " ".join(str(error).split())
