"""Where a robot begins that nobody asked for a scene."""

from __future__ import annotations

from collections.abc import Callable

from drivers import RobotDriver

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
