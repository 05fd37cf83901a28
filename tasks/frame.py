"""Geometry of a task: start and goal regions, object, success threshold."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tasks.errors import InvalidFrame

Vector2 = tuple[float, float]
Vector3 = tuple[float, float, float]


@dataclass(frozen=True)
class TaskFrame:
    """Geometry of a task, in the robot's frame. Fetch's constants are each task's default.

    Attributes:
        home: Centre of the start and goal regions, m; None for the robot's own home.
        object_height: Height of the object's centre at rest, m; None for the height that the
            robot declares, or else the height measured at the start.
        object_range: Greatest distance of an object's start from the centre in x and in y, m.
        min_object_distance: Least distance of an object's start from the centre in the plane, m.
        goal_range: Greatest distance of a goal from the centre along each axis, m.
        goal_offset: Added to every goal, m.
        air_probability: Share of goals above the table.
        air_height: Greatest height of those goals above the resting object, m.
        object_size: Half extents of the object, m.
        threshold: Distance within which a goal is reached, m.
        even_area: Lower and upper corner, relative to home in the plane, of the area in which the
            dynamics do not depend on where gripper and object are, m.
    """

    home: Vector3 | None = None
    object_height: float | None = None
    object_range: float = 0.15
    min_object_distance: float = 0.1
    goal_range: float = 0.15
    goal_offset: Vector3 = (0.0, 0.0, 0.0)
    air_probability: float = 0.0
    air_height: float = 0.45
    object_size: Vector3 = (0.025, 0.025, 0.025)
    threshold: float = 0.05
    even_area: tuple[Vector2, Vector2] = ((-0.27, -0.32), (0.17, 0.32))

    def __post_init__(self) -> None:
        for name in ("object_range", "goal_range", "threshold"):
            value = getattr(self, name)
            if not (0.0 < value < math.inf):
                raise InvalidFrame(f"{name} is {value}, allowed: above 0, in metres")
        if not 0.0 <= self.air_probability <= 1.0:
            raise InvalidFrame(f"air_probability is {self.air_probability}, allowed: 0 to 1")
        if not 0.0 <= self.air_height < math.inf:
            raise InvalidFrame(f"air_height is {self.air_height}, allowed: 0 or more, in metres")
        lower, upper = self.even_area
        if not all(
            -math.inf < low < high < math.inf for low, high in zip(lower, upper, strict=True)
        ):
            raise InvalidFrame(
                f"even_area is {self.even_area}, allowed: a lower and an upper corner, in metres"
            )
        # Starts are drawn from a square until one is far enough from its centre.
        if not 0.0 <= self.min_object_distance < self.object_range * math.sqrt(2.0):
            raise InvalidFrame(
                f"min_object_distance is {self.min_object_distance}, allowed: 0 to below "
                f"{self.object_range * math.sqrt(2.0):.4f}, the corner of object_range"
            )
