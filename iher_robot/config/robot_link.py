"""Connection to a robot without a task."""

from __future__ import annotations

from functools import partial

from drivers import InvalidSpec, RobotDriver, make_driver
from drivers.registry import make_in_first_scene
from drivers.remote import LinkOptions, ZenohDriver, link_options
from iher_robot.config.robot import REMOTE_DRIVER, ChosenRobot
from iher_robot.errors import UserError


def link_of(robot: ChosenRobot) -> LinkOptions:
    """Return the link options of a robot on the network.

    Args:
        robot: The robot.

    Raises:
        UserError: The robot has another driver, or its file has a value that is not allowed.
    """
    if robot.driver != REMOTE_DRIVER:
        raise UserError(
            f"driver is {robot.driver!r}, whose robot exists only within its own process; this "
            f"needs a served robot, driver {REMOTE_DRIVER!r}"
        )
    try:
        return link_options(robot.options)
    except InvalidSpec as error:
        raise UserError(f"robot {robot.name}: {error}") from error


def make_robot(robot: ChosenRobot) -> RobotDriver:
    """Make the driver of a robot, not yet open.

    The scene is the one that is loaded, or the first one of a driver in this process.

    Args:
        robot: The robot.

    Raises:
        UserError: Its file has a value that is not allowed.
        DriverError: The driver does not exist or does not take these options, or the host does
            not answer.
    """
    if robot.driver == REMOTE_DRIVER:
        return ZenohDriver(link_of(robot))
    make = partial(make_driver, robot.driver, **robot.options)
    return make_in_first_scene(lambda scene: make(scene=scene))[1]
