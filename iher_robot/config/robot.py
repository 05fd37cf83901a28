"""Choice of a robot: a driver and the options from a robot file."""

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
"""Default robot file of a user, in the working folder."""

# Other drivers use their own defaults.
_DEFAULT_ROBOTS = {DEFAULT_DRIVER: "fetch", REMOTE_DRIVER: "fetch"}

# Keys that the environment sets itself; the driver checks all other keys.
_NOT_OF_A_ROBOT = ("ask_human", "driver_name", "name", "render_mode", "scene", "task_name")

_PATHS = ("password_file", *TLS_PATHS)


@dataclass(frozen=True)
class ChosenRobot:
    """A driver with the options of a robot, as read from its file.

    Attributes:
        driver: Name of the driver.
        name: Name of a shipped robot, for driver ``"zenoh"`` that of a robot on the network, or
            the path of a file; empty for the driver's own defaults.
        options: Options for the driver, from the file.
    """

    driver: str
    name: str
    options: Mapping[str, Any]

    @property
    def title(self) -> str:
        """Driver and robot, such as ``"mujoco fetch"``."""
        return f"{self.driver} {Path(self.name).stem}".rstrip()

    @property
    def command_options(self) -> str:
        """Command-line options that select this robot; empty for the default one."""
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
        """Make the environment of a task on this robot, not yet connected.

        Args:
            task: Name of the task.
            render_mode: ``"rgb_array"`` or None.
            ask_human: Called with the instruction for a person at a reset; returns when that is
                done and hands are clear. Without it a reset that needs a person is an error.

        Raises:
            UserError: The robot does not fit the task, or cannot render.
            DriverError: The driver does not exist, or does not take these options.
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
    """Choose a robot and read its file.

    Args:
        driver: Name of the driver; where None that of the robot's file, or the default.
        robot: Name of a shipped robot, for driver ``"zenoh"`` that of a robot on the network, or
            the path of a YAML file; the driver's default where None.
        connect: Where to reach a robot on the network, such as ``"tcp/10.0.0.7:7447"``; what
            its file says, or this machine, where empty.
        default_driver: Driver if neither the argument nor the file names one.

    Raises:
        UserError: The robot does not exist, its file is not valid YAML, has a key that is not
            allowed or names another driver, or `connect` is given for a robot that is not on the
            network.
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
    """Choose the robot of a command for real robots.

    Without driver and robot: ``robot.yaml`` in the working folder if it exists, else ``fetch`` on
    the network. Arguments and errors are those of `choose_robot`.
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


def _named_driver(origin: str, named: object, requested: str | None) -> str | None:
    """Return the driver that a robot's file names; another requested one is an error."""
    if named is not None and (not isinstance(named, str) or not named):
        raise UserError(f"{origin}: driver is {named!r}, allowed: the name of a driver")
    if requested is not None and named != requested:
        raise UserError(
            f"{origin}: driver is {named!r}, but {requested!r} was requested; leave out "
            "--driver, or give the file of another robot"
        )
    return named
