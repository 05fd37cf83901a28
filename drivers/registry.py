"""Drivers by name: the built-in ones, and those of other packages by entry point."""

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
"""Entry-point group of driver factories."""

HOLDERS = "iher_robot.holders"
"""Entry-point group of functions that hold a robot from another process than its driver's."""

# Also in the package's metadata; named here for a checkout that is not installed.
_BUILT_IN = {"mujoco": "drivers.mujoco:make_fetch", "zenoh": "drivers.remote:make_remote"}

_SCENES = ("push", "reach", "pick_and_place", "slide")


class DriverFactory(Protocol):
    """Makes a driver for a scene, with the driver's options."""

    def __call__(self, *, scene: str, **options: object) -> RobotDriver:
        """Return the driver, not yet open."""
        ...


def driver_targets() -> dict[str, str]:
    """Return the factory of each driver, as ``"module:attribute"`` by name.

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
    """Return a function that holds a robot whose driver's process is frozen or gone.

    Args:
        name: Name of the driver, under which its package registers the function.
        options: Options of the driver.

    Returns:
        The function, which uses a separate connection to the robot; None if the driver's package
        has none. Then the robot's own hold on silence must do.
    """
    for entry in entry_points(group=HOLDERS):
        if entry.name == name:
            return partial(entry.load(), **options)
    return None


def make_driver(name: str, *, scene: str, **options: object) -> RobotDriver:
    """Make a driver by name. Errors of the driver's module are raised unchanged.

    Args:
        name: Name of the driver.
        scene: The scene that the task needs.
        options: Options of the driver.

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
        raise InvalidSpec(f"options of driver {name!r} are invalid: {error}") from error
    return factory(scene=scene, **options)


def make_in_first_scene(make: Callable[[str], RobotDriver]) -> tuple[str, RobotDriver]:
    """Make a driver in the first of the tasks' scenes that it supports.

    Args:
        make: Makes the driver for a scene.

    Returns:
        The scene and the driver.

    Raises:
        ValueError: The driver supports none of them; the error is that of the first scene.
    """
    errors: list[ValueError] = []
    for scene in _SCENES:
        try:
            return scene, make(scene)
        except ValueError as error:  # a factory's UnknownDriver, InvalidSpec or UserError
            errors.append(error)
    raise errors[0]
