"""Driver of a remote robot, whose host is reached over Zenoh."""

from __future__ import annotations

from drivers.remote.driver import ZenohDriver
from drivers.remote.link import LinkOptions, link_options
from drivers.remote.quality import LinkQuality

__all__ = ["LinkOptions", "LinkQuality", "ZenohDriver", "link_options", "make_remote"]


def make_remote(*, scene: str, **options: object) -> ZenohDriver:
    """Make the driver of a remote robot; a `drivers.registry.DriverFactory`.

    Args:
        scene: The scene that the task needs.
        options: Fields of `LinkOptions`.

    Raises:
        InvalidSpec: If an option is unknown or its value not allowed.
        LinkLost: If no host answers.
    """
    return ZenohDriver(link_options(options), scene)
