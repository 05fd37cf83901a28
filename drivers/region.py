"""Where a robot may be: its workspace, and what it must keep out of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.limits import Limits
from drivers.reasons import Clip

Array = NDArray[np.float64]


class Region:
    """How deep the end effector and the guarded parts are where they may not be."""

    def __init__(self, limits: Limits) -> None:
        self._lower = np.array(limits.workspace.lower)
        self._upper = np.array(limits.workspace.upper)
        self._centres = [(np.add(box.lower, box.upper) / 2.0) for box in limits.keep_out]
        self._halves = [(np.subtract(box.upper, box.lower) / 2.0) for box in limits.keep_out]

    def depths(self, points: Array, radii: Array) -> dict[Clip, float]:
        """Return how far a limit is exceeded, m; 0 and less is allowed.

        Args:
            points: The end effector, then centres of guarded spheres. ``(1 + n_guards, 3)``
            radii: Of the guarded spheres, m. ``(n_guards,)``

        Returns:
            Depth by reason.
        """
        ee_pos = points[0]
        outside = max((self._lower - ee_pos).max(), (ee_pos - self._upper).max())
        sizes = np.concatenate([[0.0], radii])
        inside = -np.inf
        for centre, half in zip(self._centres, self._halves, strict=True):
            beyond = np.abs(points - centre) - half
            distance = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
            distance += np.minimum(beyond.max(axis=-1), 0.0)
            inside = max(inside, float((sizes - distance).max()))
        return {Clip.WORKSPACE: float(outside), Clip.KEEP_OUT: inside}
