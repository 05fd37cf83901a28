"""Base class of goal-reaching tasks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from drivers import EndEffectorCommand, ResetRequest, RobotSpec, RobotState
from tasks.errors import UnboundTask
from tasks.frame import TaskFrame, Vector3
from tasks.goal_model import GoalModel
from tasks.layout import ObservationLayout
from tasks.symmetry import Kind, Plane, PlaneSymmetry


class GoalTask(ABC):
    """A goal-reaching task: observations, starts, goals and rewards.

    A task is created without a robot; `bind` gives it the robot's description, with home and
    control period. Rewards and achieved goals need no robot.

    Attributes:
        name: Name of the task.
        scene: Name of the scene that a simulator loads for it.
        layout: Layout of its observations.
        episode_ticks: Control ticks of an episode.
        blocks_gripper: Whether the gripper ignores the policy's action.
        default_frame: Fetch's constants.
        kinds: Kind of each entry of its observations, for `symmetry`; empty without a symmetry.
        mirrors: Normals of the upright planes of reflection that leave the task unchanged.
        rough_mirrors: Normals of those that do so approximately, and only for a robot that takes
            end-effector commands, whose motion is the same in x and y; ``xy`` for the diagonal.
    """

    name: ClassVar[str]
    scene: ClassVar[str]
    layout: ClassVar[ObservationLayout]
    episode_ticks: ClassVar[int] = 50
    blocks_gripper: ClassVar[bool]
    default_frame: ClassVar[TaskFrame]
    kinds: ClassVar[Mapping[str, Kind]] = {}
    mirrors: ClassVar[tuple[Plane, ...]] = ("x", "y")
    rough_mirrors: ClassVar[tuple[Plane, ...]] = ()

    def __init__(self, frame: TaskFrame | None = None, spec: RobotSpec | None = None) -> None:
        """Create the task.

        Args:
            frame: Its geometry; Fetch's by default.
            spec: Description of the robot, if known.
        """
        self.frame = self.default_frame if frame is None else frame
        self._spec = spec

    def bind(self, spec: RobotSpec) -> Self:
        """Return the same task for a robot.

        Args:
            spec: The robot's description.

        Raises:
            MissingObject: If the robot does not report an object that the task needs.
        """
        return type(self)(self.frame, spec)

    @property
    def spec(self) -> RobotSpec:
        """Description of the robot.

        Raises:
            UnboundTask: If the task is not bound to a robot.
        """
        if self._spec is None:
            raise UnboundTask(f"task {self.name!r} is not bound to a robot; use task.bind(spec)")
        return self._spec

    @property
    def home(self) -> Vector3:
        """Centre of the start and goal regions, m: the frame's, else the robot's own home."""
        return self.spec.home.ee_pos if self.frame.home is None else self.frame.home

    @property
    def threshold(self) -> float:
        """Distance within which a goal is reached, m."""
        return self.frame.threshold

    @property
    def goal_dim(self) -> int:
        """Length of a goal."""
        return self.goal_model.goal_dim

    @cached_property
    def goal_model(self) -> GoalModel:
        """Goals and rewards as pure functions of observations."""
        return self._make_goal_model()

    def symmetry(self, *, rough: bool = False) -> PlaneSymmetry | None:
        """Return the maps that leave dynamics and reward unchanged.

        Args:
            rough: Whether to include those that do so approximately, if the robot allows them.

        Returns:
            The maps; None if no kinds are declared.

        Raises:
            UnboundTask: If the task is not bound to a robot.
        """
        if not self.kinds:
            return None
        (x_low, y_low), (x_high, y_high) = self.frame.even_area
        x, y, _ = self.home
        area = ((x + x_low, y + y_low), (x + x_high, y + y_high))
        mirrors = self.mirrors
        if rough and EndEffectorCommand.kind in self.spec.command_kinds:
            mirrors += self.rough_mirrors
        return PlaneSymmetry(self.layout, self.kinds, area=area, mirrors=mirrors)

    @property
    def contact_model(self) -> GoalModel | None:
        """Goal model with the positions of effector and object; None without an object."""
        return None if self.layout.object_entry is None else self.goal_model

    def is_success(self, achieved: NDArray[np.floating], desired: NDArray[np.floating]) -> bool:
        """Return whether one goal is reached.

        Args:
            achieved: The goal achieved. ``(goal_dim,)``
            desired: The goal desired. ``(goal_dim,)``
        """
        return bool(self.goal_model.is_success(achieved, desired))

    @abstractmethod
    def observation(self, state: RobotState) -> NDArray[np.float64]:
        """Return the observation of a state, in the order of `layout`.

        Args:
            state: State reported by the robot.

        Returns:
            Positions in m, angles in rad, velocities in m and rad per tick. ``(obs_dim,)``

        Raises:
            UnboundTask: If the task is not bound to a robot.
        """

    @abstractmethod
    def reset_request(self, rng: np.random.Generator) -> ResetRequest:
        """Draw the places of the objects at the start of the next episode.

        Args:
            rng: Source of randomness.

        Raises:
            UnboundTask: If the task is not bound to a robot.
        """

    @abstractmethod
    def _make_goal_model(self) -> GoalModel:
        """Return the goal model; that of an unbound task cannot sample goals."""
