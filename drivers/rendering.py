"""Drivers that can show a picture of themselves."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray


@runtime_checkable
class Renderable(Protocol):
    """A driver with a camera on the scene."""

    def render(
        self, width: int, height: int, goal: NDArray[np.float64] | None = None
    ) -> NDArray[np.uint8]:
        """Return a picture of the scene, with the goal marked if one is given.

        Args:
            width: Pixels.
            height: Pixels.
            goal: Position in the spec's frame, m. ``(3,)``

        Returns:
            RGB. ``(height, width, 3)``
        """
        ...
