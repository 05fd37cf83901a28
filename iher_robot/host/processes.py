"""Entry points of the processes of a host: the robot process and the gateway."""

from __future__ import annotations

import logging
import os
import signal
import socket
import sys
from contextlib import ExitStack
from functools import partial
from multiprocessing.connection import Connection

import zenoh

from drivers import DriverError, RobotDriver, make_driver
from drivers.clock import MonotonicClock
from iher_robot.errors import UserError
from iher_robot.host.control_loop import ControlLoop
from iher_robot.host.heartbeat import Heartbeat
from iher_robot.host.network.access import gateway_config
from iher_robot.host.network.channels import Channel
from iher_robot.host.network.gateway import Gateway
from iher_robot.host.network.security import read_security
from iher_robot.host.persistence import RobotMemory, RobotTotal
from iher_robot.host.served_robot import ServedRobot
from iher_robot.host.settings import HostSettings
from iher_robot.host.tick_log import TickLog

log = logging.getLogger(__name__)

READY = b""
"""Start-up message of a process that is ready; any other one is an error message."""
_LOOP_PRIORITY = 20
_GATEWAY_PRIORITY = 10


def run_robot(
    settings: HostSettings, heartbeat: Heartbeat, end: socket.socket, startup: Connection
) -> None:
    """Run the control loop: the entry point of the robot process.

    Args:
        settings: Settings of the host.
        heartbeat: Shared with the watchdog.
        end: This process's end of the channel to the gateway.
        startup: Gets an error message, or an empty one once the robot is served.
    """
    _ignore_signals()
    _request_real_time_priority(_LOOP_PRIORITY)
    clock = MonotonicClock()
    try:
        memory = RobotMemory(settings.memory_path)
        with ExitStack() as stack:
            total = stack.enter_context(RobotTotal(settings.memory_path, settings.name))
            path = settings.tick_log_path
            tick_log = None if path is None else stack.enter_context(TickLog(path))
            make = partial(_make_served, settings)
            robot = ServedRobot(make, settings.scene, memory, settings.perception, clock)
            channel = Channel(end)
            loop = ControlLoop(settings, robot, total, memory, channel, heartbeat, clock, tick_log)
            loop.run(lambda: _report(startup, READY))
    except (UserError, DriverError) as error:
        if startup.closed:
            log.error("%s", error)
            sys.exit(1)
        _report(startup, str(error).encode())


def run_gateway(
    settings: HostSettings, heartbeat: Heartbeat, end: socket.socket, startup: Connection
) -> None:
    """Run the gateway: the entry point of its process. Arguments as for `run_robot`."""
    del heartbeat
    _ignore_signals()
    _request_real_time_priority(_GATEWAY_PRIORITY)
    try:
        security = read_security(settings.security_path)
        config = gateway_config(settings.name, settings.listen, security, settings.insecure)
        session = zenoh.open(config)
    except (UserError, DriverError) as error:
        _report(startup, str(error).encode())
        return
    except zenoh.ZError as error:
        where = ", ".join(settings.listen)
        reason = str(error).split(" at /")[0]  # without the place in Zenoh's sources
        problem = f"cannot listen on {where}: {reason}; if another host runs there, choose another"
        _report(startup, f"{problem} --listen".encode())
        return
    with session:
        gateway = Gateway(session, settings.name, Channel(end))
        _report(startup, READY)
        gateway.run()


def _report(startup: Connection, problem: bytes) -> None:
    startup.send_bytes(problem)
    startup.close()


def _make_served(settings: HostSettings, scene: str) -> RobotDriver:
    driver = make_driver(settings.driver, **({"scene": scene} | dict(settings.options)))
    spec = driver.spec
    if not spec.enforces_joint_limits and not settings.without_joint_limits:
        raise UserError(
            f"{spec.name} enforces no joint limits: its joints may move too fast; serve another "
            "robot, or this one with --without-joint-limits"
        )
    if driver.exclusive and not spec.physical:
        raise UserError(
            f"driver is {settings.driver!r}, whose robot is already served by another host; name "
            "the driver that moves the robot"
        )
    return driver


def _request_real_time_priority(priority: int) -> None:
    """Request real-time scheduling: a tick must not wait for other processes."""
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(priority))
    except PermissionError:  # the usual case; ticks are a little less regular
        log.info("no real-time scheduling: the system does not permit it")


def _ignore_signals() -> None:
    # Ctrl-C reaches every process of the terminal; the watchdog ends these two in order.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
