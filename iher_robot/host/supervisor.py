"""The watchdog of a host: it starts the robot process and the gateway, and watches both."""

from __future__ import annotations

import logging
import multiprocessing
import socket
import time
from collections.abc import Callable
from multiprocessing.context import SpawnContext, SpawnProcess

from drivers.gate import Fault
from iher_robot.errors import UserError
from iher_robot.host.heartbeat import Heartbeat
from iher_robot.host.network.channels import channel_ends
from iher_robot.host.persistence import RobotMemory
from iher_robot.host.processes import READY, run_gateway, run_robot
from iher_robot.host.settings import HostSettings

log = logging.getLogger(__name__)

WATCHDOG_FAULT = "watchdog"
_CHECK_PERIOD_S = 0.02
_START_TIMEOUT_S = 120.0
_END_TIMEOUT_S = 5.0
_ROBOT = "robot process"
_GATEWAY = "gateway"


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
            self._robot = self._start_process(_ROBOT, run_robot, robot_end)
            self._gateway = self._start_process(_GATEWAY, run_gateway, gateway_end)
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
            for process, what in ((self._robot, _ROBOT), (self._gateway, _GATEWAY)):
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
                log.error(
                    "the %s did not end within %g s and is killed", process.name, _END_TIMEOUT_S
                )
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

    def _start_process(
        self, name: str, target: Callable[..., None], end: socket.socket
    ) -> SpawnProcess:
        receiving, sending = self._context.Pipe(duplex=False)
        process = self._context.Process(
            target=target,
            args=(self._settings, self._heartbeat, end, sending),
            name=name,
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
                        f"the {name} of {self._settings.name!r} did not start within "
                        f"{_START_TIMEOUT_S:g} s; see its messages above"
                    )
            try:
                problem = receiving.recv_bytes()
            except EOFError:
                process.join()
                raise HostFailed(
                    f"the {name} of {self._settings.name!r} ended while it started, with exit code "
                    f"{process.exitcode}; see its messages above"
                ) from None
        if problem != READY:
            process.join()
            raise HostFailed(problem.decode())
        return process
