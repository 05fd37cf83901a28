"""What can go wrong with a task."""

from __future__ import annotations


class TaskError(Exception):
    """Base of every error that a task raises."""


class UnknownTask(TaskError, ValueError):
    """No task has this name."""


class InvalidFrame(TaskError, ValueError):
    """A task frame in which no episode can start."""


class UnboundTask(TaskError, RuntimeError):
    """A call that needs the robot's description, which `GoalTask.bind` gives."""


class MissingObject(TaskError, ValueError):
    """The robot does not report an object that the task is about."""
