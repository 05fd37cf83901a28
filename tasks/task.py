"""What is asked of a robot."""

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

    A task is made without a robot; `bind` gives it the robot's description, which says
    where home is and how long a tick takes. Rewards and achieved goals need no robot.

    Attributes:
        name: Name of the task.
        scene: Name of the scene that a simulator sets up for it.
        layout: Layout of its observations.
        episode_ticks: Control ticks of an episode.
        blocks_gripper: Whether the gripper stays as it is, whatever the policy asks.
        default_frame: Fetch's constants.
        kinds: What each entry of its observations is, for `symmetry`; empty without one.
        mirrors: Normals of the upright planes whose mirror images leave the task as it is.
        rough_mirrors: Those whose mirror images do so only roughly, and only for a robot that
            takes commands of its end effector, which moves alike in x and y; ``xy`` for the
            diagonal.
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
        """Set the task up.

        Args:
            frame: Its geometry; Fetch's by default.
            spec: Description of the robot, if it is known already.
        """
        self.frame = self.default_frame if frame is None else frame
        self._spec = spec

    def bind(self, spec: RobotSpec) -> Self:
        """Return the same task for a robot.

        Args:
            spec: The robot's description.

        Raises:
            MissingObject: If the robot does not report an object that the task is about.
        """
        return type(self)(self.frame, spec)

    @property
    def spec(self) -> RobotSpec:
        """Description of the robot.

        Raises:
            UnboundTask: If there is none yet.
        """
        if self._spec is None:
            raise UnboundTask(f"task {self.name!r} knows no robot yet; use task.bind(spec)")
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
        """Return the maps that leave dynamics and reward as they are.

        Args:
            rough: Whether those are among them that do so only roughly, if the robot is one for
                them.

        Returns:
            The maps; None where no kinds are declared.

        Raises:
            UnboundTask: If the task knows no robot yet.
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
        """Where effector and object are; None without an object."""
        return None if self.layout.object_entry is None else self.goal_model

    def is_success(self, achieved: NDArray[np.floating], desired: NDArray[np.floating]) -> bool:
        """Return whether one goal is reached.

        Args:
            achieved: The goal achieved. ``(goal_dim,)``
            desired: The goal wanted. ``(goal_dim,)``
        """
        return bool(self.goal_model.is_success(achieved, desired))

    @abstractmethod
    def observation(self, state: RobotState) -> NDArray[np.float64]:
        """Return the observation of a state, in the order of `layout`.

        Args:
            state: As the robot reported it.

        Returns:
            Positions in m, angles in rad, velocities in m and rad per tick. ``(obs_dim,)``

        Raises:
            UnboundTask: If the task knows no robot yet.
        """

    @abstractmethod
    def reset_request(self, rng: np.random.Generator) -> ResetRequest:
        """Draw where things should be when the next episode starts.

        Args:
            rng: Source of randomness.

        Raises:
            UnboundTask: If the task knows no robot yet.
        """

    @abstractmethod
    def _make_goal_model(self) -> GoalModel:
        """Return the goal model. An unbound task's cannot sample goals."""
