"""Symmetries of a task: translations in the table's plane and reflections in upright planes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum, auto
from typing import ClassVar, Generic, Literal

from tasks.arrays import ArrayT, copied
from tasks.layout import ObservationLayout

Corner = tuple[float, float]
Plane = Literal["x", "y", "xy"]

_AXES = 3


class Kind(StrEnum):
    """How a spatial map acts on an entry of an observation.

    Attributes:
        POSITION: A point: x, y, z.
        VECTOR: A difference of points, or a velocity.
        AXIAL: An angular velocity, or Euler angles about x, y and z: a reflection keeps the
            component along its normal and negates the others.
        FINGERS: Right and left finger, which a reflection with normal y exchanges.
    """

    POSITION = auto()
    VECTOR = auto()
    AXIAL = auto()
    FINGERS = auto()


@dataclass(frozen=True, eq=False)
class PlaneMap(Generic[ArrayT]):
    """A batch of maps, one per row: reflections, then a translation.

    Attributes:
        symmetry: The symmetry that the maps belong to.
        diagonal: 1 where x and y are exchanged first, else 0. ``(batch, 1)``
        sign: -1 for each axis that is reflected, else 1. ``(batch, 3)``
        offset: Added to a position after the multiplication by `sign`, m. ``(batch, 3)``
    """

    symmetry: PlaneSymmetry
    diagonal: ArrayT
    sign: ArrayT
    offset: ArrayT

    def observation(self, observation: ArrayT) -> ArrayT:
        """Map observations; a new array. ``(batch, obs_dim)``"""
        image = copied(observation)
        for name, kind in self.symmetry.kinds.items():
            where = self.symmetry.layout.slices[name]
            image[..., where] = self._entry(kind, observation[..., where])
        return image

    def action(self, action: ArrayT) -> ArrayT:
        """Map actions: dx, dy, dz, then components without a direction. ``(batch, action_dim)``"""
        image = copied(action)
        image[..., :_AXES] = self.sign * self._exchanged(action[..., :_AXES])
        return image

    def goal(self, goal: ArrayT) -> ArrayT:
        """Map goals, which are positions, m. ``(batch, 3)``"""
        return self._entry(Kind.POSITION, goal)

    def _entry(self, kind: Kind, value: ArrayT) -> ArrayT:
        if kind is Kind.FINGERS:
            keep: ArrayT = (self.sign[..., 1:2] + 1.0) / 2.0
            swapped: ArrayT = keep * value + (1.0 - keep) * value[..., [1, 0]]
            return swapped
        image: ArrayT = self.sign * self._exchanged(value)
        if kind is Kind.POSITION:
            image = image + self.offset
        elif kind is Kind.AXIAL:
            turned = self.sign[..., 0:1] * self.sign[..., 1:2] * (1.0 - 2.0 * self.diagonal)
            image = turned * image
        return image

    def _exchanged(self, value: ArrayT) -> ArrayT:
        exchanged: ArrayT = self.diagonal * value[..., [1, 0, 2]] + (1.0 - self.diagonal) * value
        return exchanged


class PlaneSymmetry:
    """Translations along the table and reflections in upright planes.

    They leave dynamics and rewards unchanged while gripper and object are within `area`, where
    the table is level and the arm moves freely. A step that begins or ends with one of them
    outside is mapped to itself. The diagonal reflection, which exchanges x and y, holds for a
    gripper that is as wide as thick and an object that lies flat: the Euler angles of a tilted
    one would have another order of axes.

    The maps follow from numbers in [0, 1) that the caller draws, `draws` of them per row.
    """

    draws: ClassVar[int] = 5

    def __init__(
        self,
        layout: ObservationLayout,
        kinds: Mapping[str, Kind],
        *,
        area: tuple[Corner, Corner],
        shift_m: float = 0.1,
        mirrors: Sequence[Plane] = ("x", "y"),
    ) -> None:
        """Define the symmetry for the observations of a layout.

        Args:
            layout: Layout of the observations.
            kinds: Kind of each of its entries.
            area: Lower and upper corner, x and y in the robot's frame, m.
            shift_m: Largest translation along each of the two axes, m.
            mirrors: Normals of the planes of reflection, which pass through the centre of the
                area, and ``xy`` for the diagonal.

        Raises:
            ValueError: If `kinds` does not name exactly the entries of the layout.
        """
        if set(kinds) != set(layout.names):
            raise ValueError(
                f"kinds names {sorted(kinds)}, allowed: the entries of the layout, "
                f"{sorted(layout.names)}"
            )
        self.layout = layout
        self.kinds = dict(kinds)
        self.mirrors = tuple(mirrors)
        self._shift_m = shift_m
        (x_low, y_low), (x_high, y_high) = area
        self._centre = ((x_low + x_high) / 2.0, (y_low + y_high) / 2.0)
        self._half = ((x_high - x_low) / 2.0, (y_high - y_low) / 2.0)
        bounded = [layout.effector]
        if layout.object_entry is not None:
            bounded.append(layout.object_entry)
        self._bounded = [layout.slices[name].start for name in bounded]

    @property
    def shifted(self) -> tuple[int, ...]:
        """Indices of the observation that a translation changes: x and y of every position."""
        starts = [
            self.layout.slices[name].start
            for name, kind in self.kinds.items()
            if kind is Kind.POSITION
        ]
        return tuple(start + axis for start in starts for axis in (0, 1))

    def choose(self, uniform: ArrayT, start: ArrayT, end: ArrayT) -> PlaneMap[ArrayT]:
        """Choose a map for each step.

        Args:
            uniform: Numbers in [0, 1). ``(batch, draws)``
            start: Observations before the step. ``(batch, obs_dim)``
            end: Observations after the step; ``start`` again where there is none.

        Returns:
            The maps; the identity where the step is not within the area.
        """
        sign, offset = copied(start[..., :_AXES]), copied(start[..., :_AXES])
        sign[...], offset[...] = 1.0, 0.0
        inside = uniform[..., 0] >= 0.0
        diagonal = self._diagonal(uniform, start, end)
        for axis, name in enumerate(("x", "y")):
            centre, half = self._centre[axis], self._half[axis]
            other = self._centre[1 - axis]
            places = [
                diagonal * (o[..., at + 1 - axis] - other)
                + (1.0 - diagonal) * (o[..., at + axis] - centre)
                for o in (start, end)
                for at in self._bounded
            ]
            if name in self.mirrors:
                sign[..., axis] = 1.0 - 2.0 * (uniform[..., axis] < 0.5)
            least = greatest = sign[..., axis] * places[0]
            for place in places[1:]:
                least = least.clip(None, sign[..., axis] * place)
                greatest = greatest.clip(sign[..., axis] * place, None)
            inside = inside & (least >= -half) & (greatest <= half)
            shift = (2.0 * uniform[..., 2 + axis] - 1.0) * self._shift_m
            shift = shift.clip(-half - least, None).clip(None, half - greatest)
            moved = diagonal * other + (1.0 - diagonal) * centre
            offset[..., axis] = centre - sign[..., axis] * moved + shift
        sign[~inside], offset[~inside], diagonal[~inside] = 1.0, 0.0, 0.0
        return PlaneMap(self, diagonal[..., None], sign, offset)

    def _diagonal(self, uniform: ArrayT, start: ArrayT, end: ArrayT) -> ArrayT:
        """Return 1 to exchange x and y, for half of the rows that allow it, else 0. ``(batch,)``"""
        least = min(self._half)
        chosen = uniform[..., 4] < (0.5 if "xy" in self.mirrors else 0.0)
        for o in (start, end):
            for at in self._bounded:
                for axis in (0, 1):
                    place = o[..., at + axis] - self._centre[axis]
                    chosen = chosen & (abs(place) <= least)
        exchanged = copied(start[..., 0])
        exchanged[...] = 0.0
        exchanged[chosen] = 1.0
        return exchanged
