"""The processes of a host: robot process, gateway, and the watchdog that starts both."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import socket
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext, SpawnProcess

import zenoh

from drivers import DriverError, RobotDriver, make_driver
from drivers.clock import MonotonicClock
from drivers.gate import Fault
from iher_robot.errors import UserError
from iher_robot.host.control_loop import ControlLoop
from iher_robot.host.heartbeat import Heartbeat
from iher_robot.host.network.access import gateway_config
from iher_robot.host.network.channels import Channel, channel_ends
from iher_robot.host.network.gateway import Gateway
from iher_robot.host.network.security import read_security
from iher_robot.host.persistence import RobotMemory, RobotTotal
from iher_robot.host.served_robot import ServedRobot
from iher_robot.host.settings import HostSettings
from iher_robot.host.tick_log import TickLog

log = logging.getLogger(__name__)

WATCHDOG_FAULT = "watchdog"
_CHECK_PERIOD_S = 0.02
_START_TIMEOUT_S = 120.0
_END_TIMEOUT_S = 5.0
_READY = b""
_LOOP_PRIORITY = 20
_GATEWAY_PRIORITY = 10


class HostFailed(UserError):
    """A host could not start, or ended unexpectedly."""


class Host:
    """A robot process and a gateway, with the watchdog in this process.

    Args:
        settings: Settings of the host.
        holder: Holds the robot from another process than the one that drives it. None where the
            driver's package has no such function: then the robot's own hold on silence must do.
    """

    def __init__(self, settings: HostSettings, holder: Callable[[], None] | None = None) -> None:
        self._settings = settings
        self._holder = holder
        self._context: SpawnContext = multiprocessing.get_context("spawn")
        self._heartbeat = Heartbeat(self._context)
        self._robot: SpawnProcess | None = None
        self._gateway: SpawnProcess | None = None

    def start(self) -> None:
        """Start both processes, and return once the robot is served.

        Raises:
            HostFailed: One of them could not start; both have ended.
        """
        self._heartbeat.beat()
        robot_end, gateway_end = channel_ends()
        try:
            self._robot = self._start_process(run_robot, robot_end)
            self._gateway = self._start_process(run_gateway, gateway_end)
        except BaseException:
            self.stop()
            raise
        finally:
            robot_end.close()
            gateway_end.close()

    def watch(self) -> None:
        """Run the watchdog until an exception, such as an interrupt, ends it.

        Raises:
            HostFailed: A process ended, or the control loop froze: it is killed, the robot is
                held, and the fault is latched.
        """
        assert self._robot is not None and self._gateway is not None  # noqa: PT018
        while True:
            self._heartbeat.beat()
            if self._heartbeat.overdue_s > 0:
                self._intervene()
            for process, what in ((self._robot, "robot process"), (self._gateway, "gateway")):
                if not process.is_alive():
                    if process is self._robot:
                        self._call_holder()
                    raise HostFailed(
                        f"the {what} of {self._settings.name!r} ended with exit code "
                        f"{process.exitcode}; the robot is held; see its messages above, then "
                        "start the host again"
                    )
            time.sleep(_CHECK_PERIOD_S)

    def stop(self) -> None:
        """End both processes; the robot is held, disarmed and disconnected first."""
        self._heartbeat.end()
        for process in (self._robot, self._gateway):
            if process is None:
                continue
            deadline = time.monotonic() + _END_TIMEOUT_S
            while process.is_alive() and time.monotonic() < deadline:
                self._heartbeat.beat()
                process.join(_CHECK_PERIOD_S)
            if process.is_alive():
                log.error("%s did not end within %g s and is killed", process.name, _END_TIMEOUT_S)
                process.kill()
                process.join()

    def _intervene(self) -> None:
        """Kill a control loop that missed its deadline, hold the robot and latch the fault."""
        assert self._robot is not None
        overdue_ms = 1e3 * self._heartbeat.overdue_s
        # It may resume at any time and command the robot.
        self._robot.kill()
        self._robot.join()
        reason = f"the control loop was frozen ({overdue_ms:.0f} ms past its deadline)"
        self._call_holder()
        memory = RobotMemory(self._settings.memory_path)
        kept = memory.fault or Fault(WATCHDOG_FAULT, reason, 0)  # the first stop is kept
        memory.save_fault(lambda: kept)
        raise HostFailed(
            f"robot {self._settings.name!r}: {reason} and was killed, the robot is held and the "
            "fault latched; find the cause, start the host again, then: iher-robot clear-fault "
            f"{kept.name}"
        )

    def _call_holder(self) -> None:
        """Hold a robot whose process is gone, if the driver's package has a holder."""
        if self._holder is None:
            return  # the robot holds on silence
        try:
            self._holder()
        except Exception:  # whatever a holder raises, the fault must still be latched
            log.exception("the holder of %r failed; use the robot's own stop", self._settings.name)

    def _start_process(self, target: Callable[..., None], end: socket.socket) -> SpawnProcess:
        receiving, sending = self._context.Pipe(duplex=False)
        process = self._context.Process(
            target=target,
            args=(self._settings, self._heartbeat, end, sending),
            name=target.__name__,
        )
        process.start()
        sending.close()
        with receiving:
            deadline = time.monotonic() + _START_TIMEOUT_S
            while not receiving.poll(_CHECK_PERIOD_S):
                self._heartbeat.beat()
                if time.monotonic() > deadline:
                    process.kill()
                    raise HostFailed(
                        f"{target.__name__} did not start within {_START_TIMEOUT_S:g} s"
                    )
            try:
                problem = receiving.recv_bytes()
            except EOFError:
                process.join()
                raise HostFailed(
                    f"{target.__name__} ended while it started, with exit code {process.exitcode}; "
                    "see its messages above"
                ) from None
        if problem != _READY:
            process.join()
            raise HostFailed(problem.decode())
        return process


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
            loop.run(lambda: _report(startup, _READY))
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
        _report(startup, _READY)
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
