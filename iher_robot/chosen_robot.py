"""The robot of a run: a driver, and the options that a robot file gives it."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers import InvalidSpec
from iher_robot.config_source import robot_layer
from iher_robot.env import GoalRobotEnv, make_env
from iher_robot.errors import UserError

DEFAULT_DRIVER = "mujoco"

_DEFAULT_ROBOTS = {DEFAULT_DRIVER: "fetch"}  # of a driver not in here: its own defaults

# What the environment decides itself; the rest of a file is for the driver to judge.
_NOT_OF_A_ROBOT = ("driver_name", "name", "render_mode", "scene", "task_name")


@dataclass(frozen=True)
class ChosenRobot:
    """A robot as a run begins with it, whatever becomes of its file.

    Attributes:
        driver: Name of the driver.
        name: Name of a shipped robot, or the path of a file; empty for the driver's own defaults.
        options: What the file says, for the driver.
    """

    driver: str
    name: str
    options: Mapping[str, Any]

    @property
    def title(self) -> str:
        """Driver and robot in two words, such as ``"mujoco fetch"``."""
        return f"{self.driver} {Path(self.name).stem}".rstrip()

    @property
    def command_options(self) -> str:
        """What to add to a command so that it uses this robot; empty for the default one."""
        words = [] if self.driver == DEFAULT_DRIVER else ["--driver", self.driver]
        if self.name != _DEFAULT_ROBOTS.get(self.driver, ""):
            words += ["--robot", self.name]
        return "".join(f" {shlex.quote(word)}" for word in words)

    def make_env(self, task: str, render_mode: str | None = None) -> GoalRobotEnv:
        """Put a task on the robot, which is not yet connected.

        Args:
            task: Name of the task.
            render_mode: ``"rgb_array"`` or None.

        Raises:
            UserError: The robot does not fit the task, or cannot render.
            DriverError: There is no such driver, or it does not take these options.
        """
        try:
            return make_env(task, self.driver, render_mode=render_mode, **self.options)
        except InvalidSpec as error:
            if not self.name:
                raise
            raise UserError(f"robot {self.name}: {error}") from error


def choose_robot(driver: str, robot: str | None) -> ChosenRobot:
    """Read the file of a robot.

    Args:
        driver: Name of the driver.
        robot: Name of a shipped robot, or the path of a YAML file; the driver's default where
            None.

    Raises:
        UserError: No such robot, no valid YAML, or a key that is not the robot's.
    """
    name = _DEFAULT_ROBOTS.get(driver, "") if robot is None else robot
    if robot is None and not name:
        return ChosenRobot(driver, "", {})
    layer = robot_layer(name)
    options = {str(key): value for key, value in layer.values.items()}
    for key in _NOT_OF_A_ROBOT:
        if key in options:
            reason = "the scene is the task's" if key == "scene" else "it is not the robot's"
            raise UserError(f"{layer.origin}: {key} cannot be set there, {reason}; leave it out")
    return ChosenRobot(driver, name, options)
