"""The reach task: bring the gripper to a goal."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from drivers import ResetRequest, RobotState
from tasks.arrays import FloatArray
from tasks.frame import TaskFrame, Vector3
from tasks.goal_model import GoalModel
from tasks.layout import ObservationLayout
from tasks.symmetry import Kind
from tasks.task import GoalTask


class ReachGoals(GoalModel):
    """Goals in a cube around home, reached by the gripper."""

    def __init__(self, layout: ObservationLayout, frame: TaskFrame, home: Callable[[], Vector3]):
        """Define the goals.

        Args:
            layout: Layout of the observations.
            frame: Geometry of the task.
            home: Returns the centre of the goal region, m, once it is known.
        """
        super().__init__(layout, layout.effector, frame.threshold)
        self._frame = frame
        self._home = home

    def sample_goal(self, rng: np.random.Generator, start_obs: FloatArray) -> NDArray[np.float64]:
        """Draw a goal for each start, uniformly from the cube."""
        reach = self._frame.goal_range
        drawn = rng.uniform(-reach, reach, size=(len(start_obs), 3))
        goals: NDArray[np.float64] = np.array(self._home()) + drawn
        goals += np.array(self._frame.goal_offset)
        return goals


class Reach(GoalTask):
    """FetchReach-v4: bring the gripper to a point in the air."""

    name = "reach"
    scene = "reach"
    blocks_gripper = True
    default_frame = TaskFrame()
    layout = ObservationLayout(
        sizes=(("gripper_pos", 3), ("fingers_pos", 2), ("gripper_vel", 3), ("fingers_vel", 2)),
    )
    kinds = {  # noqa: RUF012
        "gripper_pos": Kind.POSITION,
        "fingers_pos": Kind.FINGERS,
        "gripper_vel": Kind.VECTOR,
        "fingers_vel": Kind.FINGERS,
    }

    def observation(self, state: RobotState) -> NDArray[np.float64]:
        """Return gripper and fingers, positions then velocities."""
        tick_s = self.spec.control_period_s
        return np.concatenate(
            [state.ee_pos, state.fingers_pos, state.ee_linvel * tick_s, state.fingers_vel * tick_s]
        )

    def reset_request(self, rng: np.random.Generator) -> ResetRequest:  # noqa: ARG002
        """Return an empty request: there is no object, and nothing is drawn."""
        return ResetRequest()

    def _make_goal_model(self) -> GoalModel:
        return ReachGoals(self.layout, self.frame, lambda: self.home)
