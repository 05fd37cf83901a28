"""A robot as an operator reaches it, without a task."""

from __future__ import annotations

from functools import partial

from drivers import InvalidSpec, RobotDriver, make_driver
from drivers.registry import make_in_first_scene
from drivers.remote import LinkOptions, ZenohDriver, link_options
from iher_robot.config.robot import REMOTE_DRIVER, ChosenRobot
from iher_robot.errors import UserError


def link_of(robot: ChosenRobot) -> LinkOptions:
    """Return how a robot on the network is reached.

    Args:
        robot: The robot.

    Raises:
        UserError: Another driver moves it, or its file says something that is not allowed.
    """
    if robot.driver != REMOTE_DRIVER:
        raise UserError(
            f"driver is {robot.driver!r}, whose robot lives only as long as the command that runs "
            f"it; this needs a served robot, driver {REMOTE_DRIVER!r}"
        )
    try:
        return link_options(robot.options)
    except InvalidSpec as error:
        raise UserError(f"robot {robot.name}: {error}") from error


def make_robot(robot: ChosenRobot) -> RobotDriver:
    """Make the driver of a robot, not yet open.

    Its scene is the one in force, or the first that a driver in this process has.

    Args:
        robot: The robot.

    Raises:
        UserError: Its file says something that is not allowed.
        DriverError: There is no such driver, it takes no such options, or nobody answers.
    """
    if robot.driver == REMOTE_DRIVER:
        return ZenohDriver(link_of(robot))
    make = partial(make_driver, robot.driver, **robot.options)
    return make_in_first_scene(lambda scene: make(scene=scene))[1]
