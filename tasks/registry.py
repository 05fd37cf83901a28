"""Registry of tasks by name."""

from __future__ import annotations

from collections.abc import Mapping

from drivers.names import unknown
from tasks.errors import UnknownTask
from tasks.frame import TaskFrame
from tasks.pick_and_place import PickAndPlace
from tasks.push import Push
from tasks.reach import Reach
from tasks.slide import Slide
from tasks.task import GoalTask

TASKS: Mapping[str, type[GoalTask]] = {
    task.name: task for task in (Reach, Push, PickAndPlace, Slide)
}


def canonical_name(name: str) -> str:
    """Return the name of a task in the registry.

    Args:
        name: The name, in which hyphens may stand for underscores.

    Raises:
        UnknownTask: If there is no such task.
    """
    canonical = name.replace("-", "_")
    if canonical not in TASKS:
        raise UnknownTask(unknown("task", name, TASKS))
    return canonical


def make_task(name: str, frame: TaskFrame | None = None) -> GoalTask:
    """Make a task by name.

    Args:
        name: Name of the task; hyphens may stand for underscores.
        frame: Its geometry; Fetch's by default.

    Returns:
        The task, not yet bound to a robot.

    Raises:
        UnknownTask: If there is no such name.
    """
    return TASKS[canonical_name(name)](frame)
