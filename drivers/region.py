"""The region in which a robot may be: its workspace without the keep-out boxes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.limits import Limits
from drivers.reasons import Clip

Array = NDArray[np.float64]


class Region:
    """Depths by which end effector and guarded parts are outside of the allowed region."""

    def __init__(self, limits: Limits) -> None:
        self._lower = np.array(limits.workspace.lower)
        self._upper = np.array(limits.workspace.upper)
        self._centres = [(np.add(box.lower, box.upper) / 2.0) for box in limits.keep_out]
        self._halves = [(np.subtract(box.upper, box.lower) / 2.0) for box in limits.keep_out]

    def depths(self, points: Array, radii: Array) -> dict[Clip, Array]:
        """Return how far each limit is exceeded, m; 0 or less is allowed.

        Args:
            points: The end effector, then centres of guarded spheres. ``(1 + n_guards, 3)``
            radii: Radii of the guarded spheres, m. ``(n_guards,)``

        Returns:
            By reason: a depth for each side of the workspace, and one for each box and point.
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
        """Return the point that each of `depths` belongs to, and its gradient with that point.

        Args:
            points: As for `depths`. ``(n_points, 3)``

        Returns:
            In the order of `depths`: indices of points ``(n_depths,)``, and unit vectors from
            the limit's nearest face, edge or corner inwards ``(n_depths, 3)``.
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
        """Return the limits that are exceeded by more than at the start of a motion.

        Args:
            depths: Depths at a later point, as from `depths`.
            allowed: Depths at the start. A part that is outside there may stay, not move out.
            slack: Tolerance for rounding, m.
        """
        return [
            reason
            for reason, depth in depths.items()
            if (depth > np.maximum(allowed[reason], 0.0) + slack).any()
        ]
