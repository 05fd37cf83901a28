"""Goal-reaching tasks: observations, goals, rewards, resets, symmetries."""

from __future__ import annotations

from tasks.errors import InvalidFrame, MissingObject, TaskError, UnboundTask, UnknownTask
from tasks.frame import TaskFrame
from tasks.goal_model import GoalModel
from tasks.layout import Difference, ObservationLayout
from tasks.pick_and_place import PickAndPlace
from tasks.push import Push
from tasks.reach import Reach
from tasks.registry import TASKS, canonical_name, make_task
from tasks.slide import Slide
from tasks.task import GoalTask

__all__ = [
    "TASKS",
    "Difference",
    "GoalModel",
    "GoalTask",
    "InvalidFrame",
    "MissingObject",
    "ObservationLayout",
    "PickAndPlace",
    "Push",
    "Reach",
    "Slide",
    "TaskError",
    "TaskFrame",
    "UnboundTask",
    "UnknownTask",
    "canonical_name",
    "make_task",
]
