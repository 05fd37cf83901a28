"""The robot of a run: a driver, and the options that a robot file gives it."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers import InvalidSpec
from iher_robot.config.layers import is_yaml_file, robot_layer
from iher_robot.config.paths import TLS_PATHS, resolve_paths
from iher_robot.env.goal_env import GoalRobotEnv, make_env
from iher_robot.errors import UserError

DEFAULT_DRIVER = "mujoco"
REMOTE_DRIVER = "zenoh"
OWN_ROBOT_FILE = "robot.yaml"
"""A user's own robot, in the working folder."""

# Of a driver not in here: its own defaults.
_DEFAULT_ROBOTS = {DEFAULT_DRIVER: "fetch", REMOTE_DRIVER: "fetch"}

# What the environment decides itself; the rest of a file is for the driver to judge.
_NOT_OF_A_ROBOT = ("ask_human", "driver_name", "name", "render_mode", "scene", "task_name")

_PATHS = ("password_file", *TLS_PATHS)


@dataclass(frozen=True)
class ChosenRobot:
    """A robot as a run begins with it, whatever becomes of its file.

    Attributes:
        driver: Name of the driver.
        name: Name of a shipped robot, for driver ``"zenoh"`` that of a robot on the network, or
            the path of a file; empty for the driver's own defaults.
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
        if self.driver == REMOTE_DRIVER:
            endpoints = self.options.get("connect", ())
            words += [word for endpoint in endpoints for word in ("--connect", str(endpoint))]
        return "".join(f" {shlex.quote(word)}" for word in words)

    def make_env(
        self,
        task: str,
        render_mode: str | None = None,
        ask_human: Callable[[str], None] | None = None,
    ) -> GoalRobotEnv:
        """Put a task on the robot, which is not yet connected.

        Args:
            task: Name of the task.
            render_mode: ``"rgb_array"`` or None.
            ask_human: Called with what a person has to do at a reset; returns when it is done
                and hands are clear. Without it a reset that needs a person is an error.

        Raises:
            UserError: The robot does not fit the task, or cannot render.
            DriverError: There is no such driver, or it does not take these options.
        """
        try:
            return make_env(
                task, self.driver, render_mode=render_mode, ask_human=ask_human, **self.options
            )
        except InvalidSpec as error:
            if not self.name:
                raise
            raise UserError(f"robot {self.name}: {error}") from error


def choose_robot(
    driver: str | None,
    robot: str | None,
    connect: Sequence[str] = (),
    default_driver: str = DEFAULT_DRIVER,
) -> ChosenRobot:
    """Read the file of a robot.

    Args:
        driver: Name of the driver; where None what the robot's file names, or the default.
        robot: Name of a shipped robot, for driver ``"zenoh"`` that of a robot on the network, or
            the path of a YAML file; the driver's default where None.
        connect: Where to reach a robot on the network, such as ``"tcp/10.0.0.7:7447"``; what
            its file says, or this machine, where empty.
        default_driver: The driver that nobody has to name.

    Raises:
        UserError: No such robot, no valid YAML, a key that is not the robot's, another driver
            than the file names, or `connect` for a robot that is not on the network.
    """
    origin, options = "", {}
    named = driver
    if robot is not None and is_yaml_file(robot):
        layer = robot_layer(robot)
        origin, options = layer.origin, _checked(layer.origin, layer.values)
        named = _named_driver(origin, options.pop("driver", driver), driver)
    chosen = default_driver if named is None else named
    name = _DEFAULT_ROBOTS.get(chosen, "") if robot is None else robot
    if connect and chosen != REMOTE_DRIVER:
        raise UserError(
            f"--connect is {connect[0]!r}, but driver {chosen!r} has no network; leave it out, or "
            f"use --driver {REMOTE_DRIVER}"
        )
    if chosen == REMOTE_DRIVER:
        options = resolve_paths(options, origin, _PATHS) if origin else {"robot": name}
        if connect:
            options["connect"] = list(connect)
    elif not origin and (robot is not None or name):
        layer = robot_layer(name)
        options = _checked(layer.origin, layer.values)
    return ChosenRobot(chosen, name, options)


def choose_own_robot(
    driver: str | None, robot: str | None, connect: Sequence[str] = ()
) -> ChosenRobot:
    """Read the file of the robot that a command for real robots means.

    Where neither driver nor robot is given it is ``robot.yaml`` in this folder, if there is one,
    else ``fetch`` on the network; the arguments and errors are those of `choose_robot`.
    """
    if driver is None and robot is None and Path(OWN_ROBOT_FILE).is_file():
        robot = OWN_ROBOT_FILE
    return choose_robot(driver, robot, connect, default_driver=REMOTE_DRIVER)


def _checked(origin: str, values: Mapping[Any, Any]) -> dict[str, Any]:
    options = {str(key): value for key, value in values.items()}
    for key in _NOT_OF_A_ROBOT:
        if key in options:
            reason = "the scene is the task's" if key == "scene" else "it is not the robot's"
            raise UserError(f"{origin}: {key} cannot be set there, {reason}; leave it out")
    return options


def _named_driver(origin: str, named: object, asked: str | None) -> str | None:
    """Return the driver that a robot's file names, which nothing else may contradict."""
    if named is not None and (not isinstance(named, str) or not named):
        raise UserError(f"{origin}: driver is {named!r}, allowed: the name of a driver")
    if asked is not None and named != asked:
        raise UserError(
            f"{origin}: driver is {named!r}, but {asked!r} is asked for; leave out --driver, or "
            "give the file of another robot"
        )
    return named
