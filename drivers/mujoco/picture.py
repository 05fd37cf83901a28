"""Pictures of the simulation."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from numpy.typing import NDArray

_GOAL_RADIUS_M = 0.02
_RED = np.array([1.0, 0.0, 0.0, 1.0], dtype=np.float32)


class Camera:
    """An offscreen camera where gymnasium-robotics' Fetch environments have theirs."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        """Open a rendering context.

        Args:
            model: The compiled scene.
            width: Pixels.
            height: Pixels.
        """
        model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
        model.vis.global_.offheight = max(model.vis.global_.offheight, height)
        self.size = (width, height)
        self._model = model
        self._renderer = mujoco.Renderer(model, height, width)
        self._view = mujoco.MjvCamera()
        self._view.distance = 2.5
        self._view.azimuth = 132.0
        self._view.elevation = -14.0
        self._view.lookat[:] = (1.3, 0.75, 0.55)

    def take(self, data: mujoco.MjData, goal: NDArray[np.float64] | None) -> NDArray[np.uint8]:
        """Render one picture, leaving the simulation untouched to the last bit.

        Args:
            data: The simulation.
            goal: Marked in red, world frame, m. ``(3,)``

        Returns:
            RGB. ``(height, width, 3)``
        """
        shown = copy.copy(data)
        mujoco.mj_forward(self._model, shown)
        self._renderer.update_scene(shown, self._view)
        if goal is not None:
            self._mark(goal)
        return np.asarray(self._renderer.render(), dtype=np.uint8)

    def close(self) -> None:
        """Free the rendering context."""
        self._renderer.close()

    def _mark(self, goal: NDArray[np.float64]) -> None:
        scene = self._renderer.scene
        if scene.ngeom >= scene.maxgeom:
            return
        mujoco.mjv_initGeom(
            scene.geoms[scene.ngeom],
            type=int(mujoco.mjtGeom.mjGEOM_SPHERE),
            size=np.full(3, _GOAL_RADIUS_M),
            pos=np.asarray(goal, dtype=np.float64),
            mat=np.eye(3).ravel(),
            rgba=_RED,
        )
        scene.ngeom += 1
