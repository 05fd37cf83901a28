"""Drivers by name: the one built in, and those that other packages bring."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable
from functools import partial
from importlib.metadata import entry_points
from typing import Protocol, cast

from drivers.driver import RobotDriver
from drivers.errors import InvalidSpec, UnknownDriver
from drivers.names import unknown

GROUP = "iher_robot.drivers"
"""Entry-point group in which a package names its driver factories."""

# Named in code as well as in the package's metadata, so that an uninstalled checkout has it.
_BUILT_IN = {"mujoco": "drivers.mujoco:make_fetch", "zenoh": "drivers.remote:make_remote"}

HOLDERS = "iher_robot.holders"
"""Entry-point group of functions that hold a robot from outside of the process that drives it."""


class DriverFactory(Protocol):
    """Makes a driver for the scene that a task names, with options of its own."""

    def __call__(self, *, scene: str, **options: object) -> RobotDriver:
        """Return the driver, not yet open."""
        ...


def driver_targets() -> dict[str, str]:
    """Return where each driver lives, as ``"module:attribute"`` by name.

    Raises:
        UnknownDriver: If two packages claim one name for different things.
    """
    targets = dict(_BUILT_IN)
    for entry in entry_points(group=GROUP):
        if targets.setdefault(entry.name, entry.value) != entry.value:
            raise UnknownDriver(
                f"driver name {entry.name!r} is claimed by {targets[entry.name]} and by "
                f"{entry.value}; uninstall one of the packages"
            )
    return targets


def make_holder(name: str, **options: object) -> Callable[[], None] | None:
    """Make what holds the robot of a driver from another process, when the driver's is frozen.

    Args:
        name: Name of the driver; a package names its function under the same name.
        options: What the driver takes.

    Returns:
        A function that holds the robot through a connection of its own; None if the driver's
        package brings none, and the robot's own hold on silence has to do.
    """
    for entry in entry_points(group=HOLDERS):
        if entry.name == name:
            return partial(entry.load(), **options)
    return None


def make_driver(name: str, *, scene: str, **options: object) -> RobotDriver:
    """Make a driver by name. An error inside the driver's module is raised as it is.

    Args:
        name: Name of the driver.
        scene: The scene that the task needs.
        options: What the driver takes besides.

    Returns:
        The driver, not yet open.

    Raises:
        UnknownDriver: If there is no such name.
        InvalidSpec: If the driver does not take these options.
    """
    targets = driver_targets()
    if name not in targets:
        raise UnknownDriver(unknown("driver", name, targets))
    module, _, attribute = targets[name].partition(":")
    factory = cast(DriverFactory, getattr(importlib.import_module(module), attribute))
    try:
        inspect.signature(factory).bind(scene=scene, **options)
    except TypeError as error:
        raise InvalidSpec(f"driver {name!r} takes no such options: {error}") from error
    return factory(scene=scene, **options)


_SCENES = ("push", "reach", "pick_and_place", "slide")


def make_in_first_scene(make: Callable[[str], RobotDriver]) -> tuple[str, RobotDriver]:
    """Make a driver in the first scene that it has.

    Args:
        make: Makes the driver for a scene.

    Returns:
        The scene and the driver.

    Raises:
        ValueError: There is none; what the first was refused with.
    """
    refused: ValueError | None = None
    for scene in _SCENES:
        try:
            return scene, make(scene)
        except ValueError as error:  # InvalidSpec, UserError: what a factory refuses a scene with
            refused = refused or error
    assert refused is not None
    raise refused
