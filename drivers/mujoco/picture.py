"""Rendering of the simulation, to images or in a window."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from drivers.mujoco.view import Goal, in_a_line, look, mark_goal, settled
from drivers.mujoco.window import Launch, Window, launch_passive
from drivers.rendering import RENDERERS, CannotRender


class Pictures:
    """Renderer and window of one simulation, each opened on first use."""

    def __init__(
        self,
        model: mujoco.MjModel,
        launch: Launch = launch_passive,
    ) -> None:
        """Store the model.

        Args:
            model: The compiled scene.
            launch: Opens the window.
        """
        self._model = model
        self._launch = launch
        self._camera: _Camera | None = None
        self._window: Window | None = None

    def take(
        self, data: mujoco.MjData, size: tuple[int, int], goal: Goal, reached: bool
    ) -> NDArray[np.uint8]:
        """Render an image, leaving the simulation unchanged to the last bit.

        Args:
            data: The simulation.
            size: Width and height, pixels.
            goal: Position to mark, world frame, m. ``(3,)``
            reached: Whether the goal is reached.

        Returns:
            RGB. ``(height, width, 3)``

        Raises:
            CannotRender: If this machine cannot render.
        """
        if self._camera is not None and self._camera.size != size:
            self._camera.close()
            self._camera = None
        if self._camera is None:
            self._camera = _Camera(self._model, size)
        return self._camera.take(data, goal, reached)

    def show(self, data: mujoco.MjData, goal: Goal, reached: bool) -> bool:
        """Update the window, leaving the simulation unchanged to the last bit.

        Args:
            data: The simulation.
            goal: Position to mark, world frame, m. ``(3,)``
            reached: Whether the goal is reached.

        Returns:
            Whether the window is still open.

        Raises:
            CannotRender: If no window can be opened.
        """
        if self._window is None:
            self._window = Window(self._model, self._launch)
        return self._window.show(data, goal, reached)

    def close(self) -> None:
        """Close the renderer and the window."""
        for shown in (self._camera, self._window):
            if shown is not None:
                shown.close()
        self._camera = self._window = None


class _Camera:
    """Renderer with the camera of gymnasium-robotics' Fetch environments."""

    def __init__(self, model: mujoco.MjModel, size: tuple[int, int]) -> None:
        width, height = size
        model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
        model.vis.global_.offheight = max(model.vis.global_.offheight, height)
        self.size = size
        self._model = model
        try:
            self._renderer = mujoco.Renderer(model, height, width)
        # AttributeError is what PyOpenGL raises for a missing library.
        except (AttributeError, ImportError, RuntimeError, mujoco.FatalError) as error:
            raise CannotRender(
                f"MuJoCo cannot render here: {in_a_line(error)}; set MUJOCO_GL to {RENDERERS}"
            ) from error
        self._view = mujoco.MjvCamera()
        look(self._view)

    def take(self, data: mujoco.MjData, goal: Goal, reached: bool) -> NDArray[np.uint8]:
        self._renderer.update_scene(settled(self._model, data), self._view)
        mark_goal(self._renderer.scene, goal, reached)
        return np.asarray(self._renderer.render(), dtype=np.uint8)

    def close(self) -> None:
        self._renderer.close()
