"""Serve a robot to clients in other processes: the application behind ``iher-robot serve``."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from drivers.registry import make_holder
from drivers.remote.keys import robot_key
from iher_robot.config.robot import REMOTE_DRIVER, ChosenRobot, choose_robot
from iher_robot.errors import UserError
from iher_robot.host.settings import HostSettings
from iher_robot.host.supervisor import Host

DEFAULT_LISTEN = ("tcp/127.0.0.1:7447",)


def serve(
    *,
    driver: str | None = None,
    robot: str | None = None,
    name: str | None = None,
    listen: Sequence[str] = DEFAULT_LISTEN,
    scene: str | None = None,
    security: Path | None = None,
    insecure: bool = False,
    without_joint_limits: bool = False,
    perception: Sequence[str] = (),
    deadman_s: float = 0.2,
    memory: Path | None = None,
    tick_log: Path | None = None,
    echo: Callable[[str], None] = print,
) -> None:
    """Serve a robot until an interrupt; it is left held and disarmed.

    Args:
        driver: Name of the driver; where None the one in the robot file, or mujoco.
        robot: Name of a robot, or the path of a YAML file; the driver's default where None.
        name: Name on the network; where None that of the robot or of the driver.
        listen: Zenoh endpoints.
        scene: The only scene served; by default the one that a client's task needs.
        security: File with certificates, users and roles.
        insecure: Listen beyond this machine without security.
        without_joint_limits: Serve a robot that enforces no joint limits.
        perception: Objects whose poses come from another publisher.
        deadman_s: Silence after which an armed client is disarmed, s.
        memory: Folder for latched fault, tick counter and ledger; by default one for each name in
            the user's state folder.
        tick_log: File that gets a line of JSON for each control tick; None for none.
        echo: Prints a line for the user.

    Raises:
        UserError: Bad input, or the host ended unexpectedly.
    """
    chosen = choose_robot(driver, robot)
    served = _served_name(chosen, name)
    if not 0.0 < deadman_s <= 10.0:
        raise UserError(f"deadman is {deadman_s} s, allowed: above 0 and up to 10 s")
    settings = HostSettings(
        name=served,
        driver=chosen.driver,
        options=dict(chosen.options),
        listen=tuple(listen),
        memory_path=_state_folder() / served if memory is None else memory,
        scene=scene,
        security_path=security,
        insecure=insecure,
        without_joint_limits=without_joint_limits,
        perception=tuple(perception),
        deadman_s=deadman_s,
        tick_log_path=tick_log,
    )
    _run_host(settings, chosen.title, echo)


def _run_host(settings: HostSettings, title: str, echo: Callable[[str], None]) -> None:
    """Run a host until an interrupt."""
    host = Host(settings, make_holder(settings.driver, **settings.options))
    try:
        host.start()
        echo(
            f"serving {title} as {settings.name!r} on {', '.join(settings.listen)}; "
            "Ctrl-C ends it\n"
            f"memory  {settings.memory_path}\n"
            f"try     iher-robot train --driver zenoh --robot {settings.name} --task reach "
            "--budget-minutes 1"
        )
        host.watch()
    except KeyboardInterrupt:
        echo("ending: the robot is held and disarmed")
    finally:
        host.stop()


def _served_name(chosen: ChosenRobot, name: str | None) -> str:
    if chosen.driver == REMOTE_DRIVER:
        raise UserError(
            f"driver is {REMOTE_DRIVER!r}, which connects to a robot that is already served; name "
            "the driver that moves it, such as mujoco"
        )
    robot = Path(chosen.name).stem if chosen.name else chosen.driver
    served = name or robot.lower().replace("_", "-")
    robot_key(served)  # raises where the name is not allowed
    return served


def _state_folder() -> Path:
    state = os.environ.get("XDG_STATE_HOME")
    return (Path(state) if state else Path.home() / ".local" / "state") / "iher-robot"
