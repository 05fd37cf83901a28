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

    def depths(self, points: Array, radii: Array) -> dict[Clip, Array]:
        """Return how far each limit is exceeded, m; 0 and less is allowed.

        Args:
            points: The end effector, then centres of guarded spheres. ``(1 + n_guards, 3)``
            radii: Of the guarded spheres, m. ``(n_guards,)``

        Returns:
            By reason, a depth for each side of the workspace, and for each box and point.
        """
        outside = np.concatenate([self._lower - points[0], points[0] - self._upper])
        sizes = np.concatenate([[0.0], radii])
        inside = [np.zeros(0)]
        for centre, half in zip(self._centres, self._halves, strict=True):
            beyond = np.abs(points - centre) - half
            distance = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
            inside.append(sizes - distance - np.minimum(beyond.max(axis=-1), 0.0))
        return {Clip.WORKSPACE: outside, Clip.KEEP_OUT: np.concatenate(inside)}

    def gradients(self, points: Array) -> tuple[NDArray[np.intp], Array]:
        """Return which point each of `depths` is that of, and how it grows as this point moves.

        Args:
            points: As for `depths`. ``(n_points, 3)``

        Returns:
            In the order of `depths`: indices of points ``(n_depths,)``, and unit vectors
            towards the limit's nearest face, edge or corner, into it ``(n_depths, 3)``.
        """
        sides = np.eye(3)
        into = [-sides, sides]
        for centre, half in zip(self._centres, self._halves, strict=True):
            offset = points - centre
            beyond = np.abs(offset) - half
            way = np.maximum(beyond, 0.0)
            distance = np.linalg.norm(way, axis=-1, keepdims=True)
            outside = distance > 0.0
            way = np.where(
                outside, way / np.where(outside, distance, 1.0), sides[beyond.argmax(-1)]
            )
            into.append(np.where(offset < 0.0, way, -way))
        n_points = len(points)
        owners = np.concatenate([np.zeros(6, int), np.tile(np.arange(n_points), len(into) - 2)])
        return owners, np.concatenate(into)

    @staticmethod
    def exceeded(depths: dict[Clip, Array], allowed: dict[Clip, Array], slack: float) -> list[Clip]:
        """Name the limits that are exceeded by more than they are already.

        Args:
            depths: Somewhere, as from `depths`.
            allowed: Where a motion starts: what is outside there may stay, but no further out.
            slack: For rounding, m.
        """
        return [
            reason
            for reason, depth in depths.items()
            if (depth > np.maximum(allowed[reason], 0.0) + slack).any()
        ]
