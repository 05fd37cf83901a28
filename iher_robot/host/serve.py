"""Serve a robot to clients in other processes: the application behind ``iher-robot serve``."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from drivers.registry import make_holder
from drivers.remote.keys import robot_key
from iher_robot.config.robot import REMOTE_DRIVER, choose_robot
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
        driver: Name of the driver that moves it; what the robot file names, or mujoco, where None.
        robot: Name of a robot, or the path of a YAML file; the driver's default where None.
        name: Name on the network; that of the robot or of the driver where None.
        listen: Zenoh endpoints.
        scene: The only scene served; by default the one that a client's task needs.
        security: File with certificates, users and roles.
        insecure: Listen beyond this machine without them.
        without_joint_limits: Serve a robot whose joint limits nobody enforces.
        perception: Objects whose poses come from another publisher.
        deadman_s: Silence of an armed client after which it is disarmed, s.
        memory: Folder for latched fault, tick counter and ledger; by default one of the robot's
            own in the user's state folder.
        tick_log: File that gets a line of JSON for each control tick; None for none.
        echo: Told what is served.

    Raises:
        UserError: Bad input, or the host ended by itself.
    """
    chosen = choose_robot(driver, robot)
    if chosen.driver == REMOTE_DRIVER:
        raise UserError(
            "driver is 'zenoh', which reaches a robot that is served already; name the driver that "
            "moves it, such as mujoco"
        )
    served = name or _served_name(chosen.name, chosen.driver)
    robot_key(served)
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
    host = Host(settings, make_holder(chosen.driver, **settings.options))
    try:
        host.start()
        echo(
            f"serving {chosen.title} as {served!r} on {', '.join(listen)}; Ctrl-C ends it\n"
            f"memory  {settings.memory_path}\n"
            f"try     iher-robot train --driver zenoh --robot {served} --task reach "
            "--budget-minutes 1"
        )
        host.watch()
    except KeyboardInterrupt:
        echo("ending: the robot is held and disarmed")
    finally:
        host.stop()


def _served_name(robot: str, driver: str) -> str:
    return (Path(robot).stem if robot else driver).lower().replace("_", "-")


def _state_folder() -> Path:
    state = os.environ.get("XDG_STATE_HOME")
    return (Path(state) if state else Path.home() / ".local" / "state") / "iher-robot"
