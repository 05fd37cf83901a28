"""The control loop of a host: it owns the robot, its time and its tick counter."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Callable
from typing import Any

from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.remote.messages import ObjectMessage
from drivers.remote.state_message import HostInfo, pack_state
from drivers.wire import WireError, unpack
from iher_robot.host.commands import CommandHandler
from iher_robot.host.heartbeat import Heartbeat
from iher_robot.host.lease import HostLease, SilenceTimer
from iher_robot.host.network.channels import Channel, ChannelMessage
from iher_robot.host.persistence import RobotMemory, RobotTotal
from iher_robot.host.requests import RequestHandler
from iher_robot.host.schedule import TickSchedule
from iher_robot.host.served_robot import ServedRobot
from iher_robot.host.settings import HostSettings
from iher_robot.host.tick_log import TickLog

_SLOW_S = 120.0
"""Longest time that a reset, or loading a scene, may take before the watchdog intervenes."""
_FROZEN_S = 0.5
"""Time beyond its period that a tick may take before the watchdog intervenes."""
_UNWATCHED_S = 1.0
"""Time without a heartbeat of the watchdog after which the robot is disarmed."""
_COMMAND_SHARE = 0.5
"""Share of a tick in which messages are handled, where the driver waits for the end of the tick."""
_FAULT_PERIOD_NS = 10**9
_LATE_MESSAGES = 64
"""Messages handled after a tick should have ended; a flood must not delay the tick further."""
_MAX_WAITING = 1024
_REFUSED_WHEN_FULL = {"command": "overrun", "object": "object_overrun"}
"""Kinds refused while that many messages wait, and the reason that is counted. The other kinds are
few: each of their senders waits for its answer."""


class ControlLoop:
    """Each tick: handle the messages that arrived, end the tick, publish the state."""

    def __init__(
        self,
        settings: HostSettings,
        robot: ServedRobot,
        total: RobotTotal,
        memory: RobotMemory,
        channel: Channel,
        heartbeat: Heartbeat,
        clock: Clock,
        tick_log: TickLog | None = None,
    ) -> None:
        """Connect the parts of a host's robot process.

        Args:
            settings: Settings of the host.
            robot: Not yet open.
            total: The robot's own account of ticks.
            memory: What the robot remembers over restarts of the host.
            channel: To the gateway.
            heartbeat: Shared with the watchdog.
            clock: Monotonic.
            tick_log: Gets an entry for each tick, None for no log.
        """
        self.boot = os.urandom(8).hex()
        self._robot, self._total, self._memory = robot, total, memory
        self._channel = channel
        self._heartbeat = heartbeat
        self._clock = clock
        self._tick_log = tick_log
        self._schedule = TickSchedule(clock)
        self._lease = HostLease(settings.name, settings.lease_s, clock)
        self._deadman = SilenceTimer(settings.deadman_s, clock)
        self._commands = CommandHandler(
            self.boot, robot, self._lease, self._deadman, clock, settings.command_age_ticks
        )
        self._requests = RequestHandler(
            boot=self.boot,
            robot=robot,
            lease=self._lease,
            commands=self._commands,
            deadman=self._deadman,
            total=total,
            fixed_scene=settings.scene,
            status=self._timing,
            slow=self._slow,
        )
        self._inbox: queue.SimpleQueue[ChannelMessage] = queue.SimpleQueue()
        self._gateway_gone = threading.Event()
        self._parent = os.getppid()
        self._published_ns = 0
        self._sent_fault: tuple[str | None, int] = (None, 0)

    def run(self, ready: Callable[[], None]) -> None:
        """Serve until the host ends; the robot is left held, disarmed and disconnected.

        Args:
            ready: Called once the robot is open and its first state is published.
        """
        self._heartbeat.set_deadline(_SLOW_S)
        reading = threading.Thread(target=self._read_channel, daemon=True, name="host channel")
        try:
            self._robot.open()
            self._schedule.start()
            self._publish()
            reading.start()
            ready()
            while not self._must_end():
                self.tick()
        finally:
            self._robot.close()

    def tick(self) -> None:
        """Run one control tick."""
        driver, period_ns = self._robot.driver, self._robot.spec.control_period_ns
        self._heartbeat.set_deadline(period_ns / 1e9 + _FROZEN_S)
        self._schedule.begin_tick(period_ns)
        if driver.paces_itself:
            self._handle_until(self._published_ns + round(_COMMAND_SHARE * period_ns))
        else:
            self._handle_until(self._schedule.next_ns)
        self._enforce_timeouts()
        driver = self._robot.driver  # another one, where a request changed the scene
        if driver.is_armed:
            self._total.tick("motion")
        elif self._lease.token:
            self._total.tick("idle")
        driver.advance()
        self._schedule.end_tick(period_ns, paces_itself=driver.paces_itself)
        self._publish()

    def _must_end(self) -> bool:
        return self._heartbeat.ending or self._gateway_gone.is_set() or os.getppid() != self._parent

    def _handle_until(self, deadline_ns: int) -> None:
        """Handle messages until the deadline, and at most a few that wait after it."""
        late = 0
        while late < _LATE_MESSAGES:
            left_s = (deadline_ns - self._clock.now_ns()) / 1e9
            late += left_s <= 0
            try:
                if left_s > 0:
                    message = self._inbox.get(timeout=left_s)
                else:
                    message = self._inbox.get_nowait()
            except queue.Empty:
                return
            self._handle(message)

    def _handle(self, message: ChannelMessage) -> None:
        if message.kind == "command":
            self._commands.take(message.body)
        elif message.kind == "request":
            reply = self._requests.answer(message.name, message.body)
            self._channel.send(ChannelMessage("reply", message.number, message.name, reply))
        elif message.kind == "object":
            self._take_pose(message)
        elif message.kind == "refused":
            self._commands.refuse(message.name, message.number)

    def _take_pose(self, message: ChannelMessage) -> None:
        try:
            self._robot.take_pose(message.name, unpack(ObjectMessage, message.body))
        except WireError as error:
            self._commands.refuse(f"object_{error.reason}")
        except DriverError:
            self._commands.refuse("object_invalid")

    def _read_channel(self) -> None:
        """Receive messages in a separate thread: a stop waits for no tick and no reset."""
        try:
            while (message := self._channel.receive()) is not None:
                self._dispatch(message)
        finally:  # a host that cannot receive a stop must end
            self._gateway_gone.set()

    def _dispatch(self, message: ChannelMessage) -> None:
        """Stop at once; queue everything else for the control loop."""
        if message.kind == "request" and message.name == "stop":
            reply = self._requests.answer("stop", message.body)
            self._channel.send(ChannelMessage("reply", message.number, "stop", reply))
        elif message.kind == "stop":
            self._requests.answer("stop", message.body)
        elif message.kind in _REFUSED_WHEN_FULL and self._inbox.qsize() >= _MAX_WAITING:
            self._commands.refuse(_REFUSED_WHEN_FULL[message.kind])
        else:
            self._inbox.put(message)

    def _enforce_timeouts(self) -> None:
        armed = self._robot.driver.is_armed
        if armed and self._deadman.expired:
            self._requests.disarm(f"no command for {self._deadman.limit_s:g} s")
        if self._lease.expire():
            self._requests.disarm("the client that had the lease sent nothing until it ended")
        if armed and self._heartbeat.unwatched_s > _UNWATCHED_S:
            self._requests.disarm("the host's watchdog is frozen")

    def _publish(self) -> None:
        state = self._robot.state()
        driver = self._robot.driver
        self._memory.reserve_ticks(state.seq)
        self._robot.save_fault()
        # Before the fault is read: a stop from now on must not seem to be in this state.
        self._requests.published(state.seq)
        info = HostInfo(
            boot=self.boot,
            token=self._lease.token,
            n=self._lease.n,
            now_ns=driver.now_ns,
            armed=driver.is_armed,
            disarmed_because=self._requests.disarmed_because,
            fault=driver.fault,
            refusals=self._commands.refusals,
            clips={str(reason): n for reason, n in driver.clips.items()},
        )
        self._commands.published(state.seq)
        self._published_ns = self._clock.now_ns()
        packed = pack_state(state, info)
        self._channel.send(ChannelMessage("state", info.token, self.boot, packed))
        name, sent_ns = self._sent_fault
        if state.fault != name or self._published_ns - sent_ns > _FAULT_PERIOD_NS:
            self._channel.send(ChannelMessage("fault", 0, self.boot, packed))
            self._sent_fault = (state.fault, self._published_ns)
        if self._tick_log is not None:
            self._tick_log.add(state, info, self._published_ns)

    def _slow(self) -> None:
        self._heartbeat.set_deadline(_SLOW_S)
        self._schedule.pause()

    def _timing(self) -> dict[str, Any]:
        lost = 0 if self._tick_log is None else self._tick_log.lost
        return self._schedule.timing() | {"ticks_not_logged": lost} | self._commands.timing()
