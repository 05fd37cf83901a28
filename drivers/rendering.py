"""Interfaces of drivers that render their scene: to an image, or in a window."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from drivers.errors import DriverError

RENDERERS = "egl (Debian packages libegl1, libopengl0, libgl1-mesa-dri) or osmesa (libosmesa6)"
"""Values of MUJOCO_GL for machines without a display, for messages."""


class CannotRender(DriverError, RuntimeError):
    """This machine cannot render; the message says what to set or install."""


@runtime_checkable
class Renderable(Protocol):
    """A driver that renders its scene to an image."""

    def render(
        self,
        width: int,
        height: int,
        goal: NDArray[np.float64] | None = None,
        reached: bool = False,
    ) -> NDArray[np.uint8]:
        """Return an image of the scene.

        Args:
            width: Pixels.
            height: Pixels.
            goal: Position of a goal to mark, in the spec's frame, m; None marks nothing. ``(3,)``
            reached: Whether the goal is reached, which the mark shows.

        Returns:
            RGB. ``(height, width, 3)``

        Raises:
            CannotRender: If this machine cannot render.
        """
        ...


@runtime_checkable
class Viewable(Protocol):
    """A driver that shows its scene in an interactive window."""

    def show(self, goal: NDArray[np.float64] | None = None, reached: bool = False) -> bool:
        """Update the window; the first call opens it, closing the driver closes it.

        Args:
            goal: Position of a goal to mark, in the spec's frame, m; None marks nothing. ``(3,)``
            reached: Whether the goal is reached, which the mark shows.

        Returns:
            Whether the window is still open: the user may close it.

        Raises:
            CannotRender: If no window can be opened.
        """
        ...
