"""The processes of a host: robot, gateway, and the watchdog that started them."""

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
_LOOK_S = 0.02
_START_S = 120.0
_END_S = 5.0
_READY = b""
_LOOP_PRIORITY = 20
_GATEWAY_PRIORITY = 10


class HostFailed(UserError):
    """A host could not start, or ended by itself."""


class Host:
    """A robot process and a gateway, watched from this process.

    Args:
        settings: What to serve.
        holder: Holds the robot from outside of the process that drives it, where the driver's
            package brings such a function; else the robot's own hold on silence does.
    """

    def __init__(self, settings: HostSettings, holder: Callable[[], None] | None = None) -> None:
        self._settings = settings
        self._holder = holder
        self._context: SpawnContext = multiprocessing.get_context("spawn")
        self._heartbeat = Heartbeat(self._context)
        self._robot: SpawnProcess | None = None
        self._gateway: SpawnProcess | None = None

    def start(self) -> None:
        """Start both, and return once the robot is served.

        Raises:
            HostFailed: One of them could not start; both have ended.
        """
        self._heartbeat.beat()
        robot_end, gateway_end = channel_ends()
        try:
            self._robot = self._begin(run_robot, robot_end)
            self._gateway = self._begin(run_gateway, gateway_end)
        except BaseException:
            self.stop()
            raise
        finally:
            robot_end.close()
            gateway_end.close()

    def watch(self) -> None:
        """Watch until the host is asked to end, by an exception such as an interrupt.

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
                        self._hold_from_outside()
                    raise HostFailed(
                        f"the {what} of {self._settings.name!r} ended by itself with exit code "
                        f"{process.exitcode}; the robot is held; see its messages above, then "
                        "start the host again"
                    )
            time.sleep(_LOOK_S)

    def stop(self) -> None:
        """End both processes; the robot is held, disarmed and disconnected first."""
        self._heartbeat.end()
        for process in (self._robot, self._gateway):
            if process is None:
                continue
            deadline = time.monotonic() + _END_S
            while process.is_alive() and time.monotonic() < deadline:
                self._heartbeat.beat()
                process.join(_LOOK_S)
            if process.is_alive():
                log.error("%s does not end by itself and is killed", process.name)
                process.kill()
                process.join()

    def _intervene(self) -> None:
        """Hold the robot of a control loop that does not come back."""
        assert self._robot is not None
        overdue_ms = 1e3 * self._heartbeat.overdue_s
        # It may wake up at any time and go on as if nothing had happened.
        self._robot.kill()
        self._robot.join()
        reason = f"the control loop was frozen (by {overdue_ms:.0f} ms when it was seen)"
        self._hold_from_outside()
        memory = RobotMemory(self._settings.memory_path)
        kept = memory.fault or Fault(WATCHDOG_FAULT, reason, 0)  # the first stop is kept
        memory.keep(lambda: kept)
        raise HostFailed(
            f"robot {self._settings.name!r}: {reason}; it was ended, the robot is held and the "
            "fault latched; find out why, start the host again, then: iher-robot clear-fault "
            f"{kept.name}"
        )

    def _hold_from_outside(self) -> None:
        """Hold a robot whose process is gone, where its driver's package says how."""
        if self._holder is None:
            return  # the robot's own hold on silence does
        try:
            self._holder()
        except Exception:  # whatever a holder raises, the fault must still be latched
            log.exception("the holder of %r failed; use the robot's own stop", self._settings.name)

    def _begin(self, target: Callable[..., None], end: socket.socket) -> SpawnProcess:
        receiving, sending = self._context.Pipe(duplex=False)
        process = self._context.Process(
            target=target,
            args=(self._settings, self._heartbeat, end, sending),
            name=target.__name__,
        )
        process.start()
        sending.close()
        with receiving:
            deadline = time.monotonic() + _START_S
            while not receiving.poll(_LOOK_S):
                self._heartbeat.beat()
                if time.monotonic() > deadline:
                    process.kill()
                    raise HostFailed(f"{target.__name__} did not start within {_START_S:g} s")
            try:
                problem = receiving.recv_bytes()
            except EOFError:
                process.join()
                raise HostFailed(
                    f"{target.__name__} ended while it started, exit code {process.exitcode}; see "
                    "its messages above"
                ) from None
        if problem != _READY:
            process.join()
            raise HostFailed(problem.decode())
        return process


def run_robot(
    settings: HostSettings, heartbeat: Heartbeat, end: socket.socket, starter: Connection
) -> None:
    """Be the robot process.

    Args:
        settings: Of the host.
        heartbeat: Shared with the watchdog.
        end: Channel to the gateway.
        starter: Told what is wrong, nothing if the robot is ready to be served.
    """
    _leave_signals_to_the_watchdog()
    _run_before_others(_LOOP_PRIORITY)
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
            loop.run(lambda: _say(starter, _READY))
    except (UserError, DriverError) as error:
        if starter.closed:
            log.error("%s", error)
            sys.exit(1)
        _say(starter, str(error).encode())


def run_gateway(
    settings: HostSettings, heartbeat: Heartbeat, end: socket.socket, starter: Connection
) -> None:
    """Be the gateway; see `run_robot`."""
    del heartbeat
    _leave_signals_to_the_watchdog()
    _run_before_others(_GATEWAY_PRIORITY)
    try:
        security = read_security(settings.security_path)
        config = gateway_config(settings.name, settings.listen, security, settings.insecure)
        session = zenoh.open(config)
    except (UserError, DriverError) as error:
        _say(starter, str(error).encode())
        return
    except zenoh.ZError as error:
        where = ", ".join(settings.listen)
        reason = str(error).split(" at /")[0]  # then comes where in Zenoh's sources
        problem = f"cannot listen on {where}: {reason}; is another host running there?"
        _say(starter, f"{problem} choose another --listen".encode())
        return
    with session:
        gateway = Gateway(session, settings.name, Channel(end))
        _say(starter, _READY)
        gateway.run()


def _say(starter: Connection, problem: bytes) -> None:
    starter.send_bytes(problem)
    starter.close()


def _make_served(settings: HostSettings, scene: str) -> RobotDriver:
    driver = make_driver(settings.driver, **({"scene": scene} | dict(settings.options)))
    spec = driver.spec
    if not spec.enforces_joint_limits and not settings.without_joint_limits:
        raise UserError(
            f"{spec.name} enforces no joint limits, so that nothing keeps its joints from moving "
            "too fast; serve another robot, or this one with --without-joint-limits"
        )
    if driver.exclusive and not spec.physical:
        raise UserError(f"driver {settings.driver!r} is itself a remote one; serve the robot there")
    return driver


def _run_before_others(priority: int) -> None:
    """Ask for real-time scheduling: a tick must not wait for whatever else computes here."""
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(priority))
    except PermissionError:  # usual without rights of its own; the ticks are a little less even
        log.info("no real-time scheduling: the system does not permit it")


def _leave_signals_to_the_watchdog() -> None:
    # A Ctrl-C reaches every process of the terminal; the watchdog ends these two in order.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
