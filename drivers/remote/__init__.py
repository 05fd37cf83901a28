"""A robot behind a host of its own, reached over Zenoh."""

from __future__ import annotations

from drivers.remote.driver import ZenohDriver
from drivers.remote.link import LinkOptions, link_options
from drivers.remote.quality import LinkQuality

__all__ = ["LinkOptions", "LinkQuality", "ZenohDriver", "link_options", "make_remote"]


def make_remote(*, scene: str, **options: object) -> ZenohDriver:
    """Make the driver of a remote robot, as the registry of drivers asks for one.

    Args:
        scene: The scene that the task needs.
        options: Those of `LinkOptions`.

    Raises:
        InvalidSpec: If an option is unknown or its value not allowed.
        LinkLost: If no host answers.
    """
    return ZenohDriver(link_options(options), scene)
