"""Base class and goal model of tasks with an object on a table."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from drivers import ResetRequest, RobotSpec, RobotState
from tasks.arrays import FloatArray
from tasks.errors import MissingObject
from tasks.frame import TaskFrame, Vector3
from tasks.goal_model import GoalModel
from tasks.layout import Difference, ObservationLayout
from tasks.rotation import quat_to_euler
from tasks.symmetry import Kind
from tasks.task import GoalTask

OBJECT = "object0"
GRIPPER_ACTIONS = (3,)
"""Indices of the action that open and close the gripper."""

OBJECT_LAYOUT = ObservationLayout(
    sizes=(
        ("gripper_pos", 3),
        ("object_pos", 3),
        ("object_rel", 3),
        ("fingers_pos", 2),
        ("object_euler", 3),
        ("object_rel_vel", 3),
        ("object_angvel", 3),
        ("gripper_vel", 3),
        ("fingers_vel", 2),
    ),
    derived=(Difference("object_rel", minuend="object_pos", subtrahend="gripper_pos"),),
    object_entry="object_pos",
)


OBJECT_KINDS = {
    "gripper_pos": Kind.POSITION,
    "object_pos": Kind.POSITION,
    "object_rel": Kind.VECTOR,
    "fingers_pos": Kind.FINGERS,
    "object_euler": Kind.AXIAL,
    "object_rel_vel": Kind.VECTOR,
    "object_angvel": Kind.AXIAL,
    "gripper_vel": Kind.VECTOR,
    "fingers_vel": Kind.FINGERS,
}


class TabletopGoals(GoalModel):
    """Goals of an object's position, on the table or above it."""

    def __init__(
        self,
        layout: ObservationLayout,
        frame: TaskFrame,
        home: Callable[[], Vector3],
        object_height: Callable[[], float | None],
        hand_actions: tuple[int, ...],
    ) -> None:
        """Define the goals.

        Args:
            layout: Layout of the observations.
            frame: Geometry of the task.
            home: Returns the centre of the goal region, m, once it is known.
            object_height: Returns the height of the resting object, m, None if it must be taken
                from the start.
            hand_actions: Indices of the action that open and close the gripper.
        """
        assert layout.object_entry is not None
        super().__init__(layout, layout.object_entry, frame.threshold, hand_actions)
        self._frame = frame
        self._home = home
        self._object_height = object_height

    def sample_goal(self, rng: np.random.Generator, start_obs: FloatArray) -> NDArray[np.float64]:
        """Draw a goal for each start; for a single start, with the same draws as the reference.

        Source: ``_sample_goal`` of `gymnasium_robotics/envs/fetch/fetch_env.py`.
        """
        frame, batch = self._frame, len(start_obs)
        reach = frame.goal_range
        goals = np.array(self._home()) + rng.uniform(-reach, reach, size=(batch, 3))
        goals += np.array(frame.goal_offset)
        height = self._object_height()
        goals[:, 2] = self.achieved_goal(start_obs)[:, 2] if height is None else height
        if frame.air_probability > 0.0:
            in_air = rng.uniform(size=batch) < frame.air_probability
            goals[in_air, 2] += rng.uniform(0.0, frame.air_height, size=int(in_air.sum()))
        return goals


class TabletopTask(GoalTask):
    """A task whose goal is a position of one object."""

    layout = OBJECT_LAYOUT
    kinds = OBJECT_KINDS

    def __init__(self, frame: TaskFrame | None = None, spec: RobotSpec | None = None) -> None:
        """Create the task.

        Args:
            frame: Its geometry; Fetch's by default.
            spec: Description of the robot, if known.

        Raises:
            MissingObject: If the robot does not report the object.
        """
        super().__init__(frame, spec)
        if spec is not None and OBJECT not in spec.objects:
            raise MissingObject(
                f"task {self.name!r} needs object {OBJECT!r}, {spec.name} reports: "
                f"{', '.join(spec.objects) or 'none'}"
            )

    @property
    def object_height(self) -> float | None:
        """Height of the resting object, m: the frame's, else the robot's, else unknown."""
        if self.frame.object_height is not None:
            return self.frame.object_height
        return self.spec.home.object_heights.get(OBJECT)

    def observation(self, state: RobotState) -> NDArray[np.float64]:
        """Return gripper, object, fingers and their velocities.

        Source: ``generate_mujoco_observations`` of
        `gymnasium_robotics/envs/fetch/fetch_env.py`, in its order of operations.
        """
        tick_s = self.spec.control_period_s
        target = state.objects[OBJECT]
        gripper_vel = state.ee_linvel * tick_s
        return np.concatenate(
            [
                state.ee_pos,
                target.pos,
                target.pos - state.ee_pos,
                state.fingers_pos,
                quat_to_euler(target.quat),
                target.linvel * tick_s - gripper_vel,
                target.angvel * tick_s,
                gripper_vel,
                state.fingers_vel * tick_s,
            ]
        )

    def reset_request(self, rng: np.random.Generator) -> ResetRequest:
        """Draw the object's position: in a square around home, but not under the gripper.

        Source: ``_reset_sim`` of `gymnasium_robotics/envs/fetch/fetch_env.py`.
        """
        reach, nearest = self.frame.object_range, self.frame.min_object_distance
        centre = np.array(self.home[:2])
        place = centre + rng.uniform(-reach, reach, size=2)
        while np.linalg.norm(place - centre) < nearest:
            place = centre + rng.uniform(-reach, reach, size=2)
        return ResetRequest({OBJECT: (float(place[0]), float(place[1]))})

    def _make_goal_model(self) -> GoalModel:
        return TabletopGoals(
            self.layout,
            self.frame,
            lambda: self.home,
            lambda: self.object_height,
            () if self.blocks_gripper else GRIPPER_ACTIONS,
        )
