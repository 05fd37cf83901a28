"""Drivers that can show themselves: a picture of the scene, or a window on it."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from drivers.errors import DriverError

RENDERERS = "egl (Debian packages libegl1, libopengl0, libgl1-mesa-dri) or osmesa (libosmesa6)"
"""What MUJOCO_GL may name where there is no display, for messages."""


class CannotRender(DriverError, RuntimeError):
    """This machine has nothing that draws; the message says what to set or install."""


@runtime_checkable
class Renderable(Protocol):
    """A driver with a camera on the scene."""

    def render(
        self,
        width: int,
        height: int,
        goal: NDArray[np.float64] | None = None,
        reached: bool = False,
    ) -> NDArray[np.uint8]:
        """Return a picture of the scene, with the goal marked if one is given.

        Args:
            width: Pixels.
            height: Pixels.
            goal: Position in the spec's frame, m. ``(3,)``
            reached: Whether the goal is reached, which its mark shows.

        Returns:
            RGB. ``(height, width, 3)``

        Raises:
            CannotRender: If nothing draws here.
        """
        ...


@runtime_checkable
class Viewable(Protocol):
    """A driver with a window on the scene, which a person may look around in."""

    def show(self, goal: NDArray[np.float64] | None = None, reached: bool = False) -> bool:
        """Bring the window up to date; the first call opens it, closing the driver closes it.

        Args:
            goal: Position in the spec's frame, m; marked if given. ``(3,)``
            reached: Whether the goal is reached, which its mark shows.

        Returns:
            Whether the window is open still: the person may close it.

        Raises:
            CannotRender: If no window opens here.
        """
        ...
