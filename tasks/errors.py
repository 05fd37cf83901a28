"""Errors of tasks."""

from __future__ import annotations


class TaskError(Exception):
    """Base of every error that a task raises."""


class UnknownTask(TaskError, ValueError):
    """No task has this name."""


class InvalidFrame(TaskError, ValueError):
    """A task frame in which no episode can start."""


class UnboundTask(TaskError, RuntimeError):
    """A call that needs the robot's description, before `GoalTask.bind`."""


class MissingObject(TaskError, ValueError):
    """The robot does not report an object that the task needs."""
