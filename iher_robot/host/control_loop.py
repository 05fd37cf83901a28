"""The control loop of a host: it owns the robot, its time and its tick counter."""

from __future__ import annotations

import logging
import os
import queue
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.remote.messages import ObjectMessage
from drivers.remote.state_message import HostInfo, pack_state
from drivers.wire import WireError, unpack
from iher_robot.host.commands import CommandHandler
from iher_robot.host.heartbeat import Heartbeat
from iher_robot.host.lease import HostLease, SilenceTimer
from iher_robot.host.network.channels import Channel, Note
from iher_robot.host.persistence import RobotMemory, RobotTotal
from iher_robot.host.requests import RequestDesk
from iher_robot.host.served_robot import ServedRobot
from iher_robot.host.settings import HostSettings
from iher_robot.host.tick_log import TickLog

log = logging.getLogger(__name__)

SLOW_S = 120.0
"""Longest time that a reset, or loading a scene, may take before the watchdog intervenes."""
_FROZEN_S = 0.5
"""Beyond its tick the loop may be late by this much before the watchdog intervenes."""
_UNWATCHED_S = 1.0
"""Without a watchdog for this long nothing may move."""
_LISTENING = 0.5
"""Share of a tick in which commands are taken for a robot that waits for its ticks itself."""
_TIMED_TICKS = 1500
_FAULT_EVERY_NS = 10**9
_LATE_NOTES = 64
"""Of what waits when a tick should end, so many are dealt with; a flood must not put it off."""
_WAITING_NOTES = 1024
_MAY_BE_REFUSED = {"command": "overrun", "object": "object_overrun"}
"""Past that many these are refused; the others are few, for each waits for its answer."""


class ControlLoop:
    """Tick by tick: take what arrived, end the tick, publish what was measured."""

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
        """Put the parts together.

        Args:
            settings: Of the host.
            robot: Not yet open.
            total: The robot's own account.
            memory: What the robot remembers.
            channel: To the gateway.
            heartbeat: Shared with the watchdog.
            clock: Monotonic.
            tick_log: Told what the robot did in each tick.
        """
        self.boot = os.urandom(8).hex()
        self._robot = robot
        self._total = total
        self._memory = memory
        self._channel = channel
        self._heartbeat = heartbeat
        self._clock = clock
        self._tick_log = tick_log
        self._lease = HostLease(settings.name, settings.lease_s, clock)
        self._deadman = SilenceTimer(settings.deadman_s, clock)
        self._desk = CommandHandler(
            self.boot, robot, self._lease, self._deadman, clock, settings.command_age_ticks
        )
        self._requests = RequestDesk(
            boot=self.boot,
            robot=robot,
            lease=self._lease,
            desk=self._desk,
            deadman=self._deadman,
            total=total,
            fixed_scene=settings.scene,
            status=self._timing,
            slow=self._slow,
        )
        self._inbox: queue.SimpleQueue[Note] = queue.SimpleQueue()
        self._gateway_gone = threading.Event()
        self._parent = os.getppid()
        self._next_ns = 0
        self._published_ns = 0
        self._was_slow = False
        self._late: deque[float] = deque(maxlen=_TIMED_TICKS)
        self._overruns = 0
        self._told_fault: tuple[str | None, int] = (None, 0)

    def run(self, ready: Callable[[], None]) -> None:
        """Serve until the host ends; the robot is left held, disarmed and disconnected.

        Args:
            ready: Called once the robot is open and its first state is published.
        """
        self._heartbeat.set_deadline(SLOW_S)
        reading = threading.Thread(target=self._read_channel, daemon=True, name="host channel")
        try:
            self._robot.open()
            self._next_ns = self._clock.now_ns()
            self._publish()
            reading.start()
            ready()
            while not self._over():
                self.tick()
        finally:
            self._robot.close()

    def tick(self) -> None:
        """One control tick."""
        period_ns = self._robot.spec.control_period_ns
        self._heartbeat.set_deadline(period_ns / 1e9 + _FROZEN_S)
        self._next_ns += period_ns
        if self._robot.driver.paces_itself:
            self._take_until(self._published_ns + round(_LISTENING * period_ns))
        else:
            self._take_until(self._next_ns)
        self._enforce_timeouts()
        if self._robot.driver.is_armed:
            self._total.tick("motion")
        elif self._lease.token:
            self._total.tick("idle")
        self._robot.driver.advance()
        self._plan_next_tick(period_ns)
        self._publish()

    def _plan_next_tick(self, period_ns: int) -> None:
        now_ns = self._clock.now_ns()
        late_ns = now_ns - self._next_ns
        if self._was_slow:  # a reset or a new scene took its time: no tick was late
            self._was_slow, self._next_ns = False, now_ns
            return
        self._late.append(late_ns / 1e6)
        if late_ns > period_ns:
            self._overruns += 1
        if late_ns > period_ns or self._robot.driver.paces_itself:  # ticks are not made up for
            self._next_ns = now_ns

    def _over(self) -> bool:
        return self._heartbeat.ending or self._gateway_gone.is_set() or os.getppid() != self._parent

    def _take_until(self, deadline_ns: int) -> None:
        """Deal with whatever arrives until then, and with some of what has arrived in any case."""
        late = 0
        while late < _LATE_NOTES:
            left_s = (deadline_ns - self._clock.now_ns()) / 1e9
            late += left_s <= 0
            try:
                note = self._inbox.get(timeout=left_s) if left_s > 0 else self._inbox.get_nowait()
            except queue.Empty:
                return
            self._take(note)

    def _take(self, note: Note) -> None:
        if note.kind == "command":
            self._desk.take(note.body)
        elif note.kind == "request":
            reply = self._requests.answer(note.name, note.body)
            self._channel.send(Note("reply", note.number, note.name, reply))
        elif note.kind == "object":
            self._see(note)
        elif note.kind == "refused":
            self._desk.refuse(note.name, note.number)

    def _see(self, note: Note) -> None:
        try:
            self._robot.see(note.name, unpack(ObjectMessage, note.body))
        except WireError as error:
            self._desk.refuse(f"object_{error.reason}")
        except DriverError:
            self._desk.refuse("object_invalid")

    def _read_channel(self) -> None:
        """Sort what arrives, in a thread of its own: a stop waits for no tick and no reset."""
        try:
            while (note := self._channel.receive()) is not None:
                self._sort(note)
        finally:  # a host that hears no stop must not go on
            self._gateway_gone.set()

    def _sort(self, note: Note) -> None:
        if note.kind == "request" and note.name == "stop":
            reply = self._requests.answer("stop", note.body)
            self._channel.send(Note("reply", note.number, "stop", reply))
        elif note.kind == "stop":
            self._requests.answer("stop", note.body)
        elif note.kind in _MAY_BE_REFUSED and self._inbox.qsize() >= _WAITING_NOTES:
            self._desk.refuse(_MAY_BE_REFUSED[note.kind])
        else:
            self._inbox.put(note)

    def _enforce_timeouts(self) -> None:
        armed = self._robot.driver.is_armed
        if armed and self._deadman.expired:
            self._requests.disarm(f"no command for {self._deadman.limit_s:g} s")
        if self._lease.expire():
            self._requests.disarm("the client that had the robot has fallen silent")
        if armed and self._heartbeat.unwatched_s > _UNWATCHED_S:
            self._requests.disarm("the host's watchdog is frozen")

    def _publish(self) -> None:
        state = self._robot.state()
        driver = self._robot.driver
        self._memory.count(state.seq)
        self._robot.keep_fault()
        # Before the fault is looked at: a stop from now on must not seem to be in this state.
        self._requests.published(state.seq)
        info = HostInfo(
            boot=self.boot,
            token=self._lease.token,
            n=self._lease.n,
            now_ns=driver.now_ns,
            armed=driver.is_armed,
            disarmed_because=self._requests.disarmed_because,
            fault=driver.fault,
            refusals=self._desk.refusals,
            clips={str(reason): n for reason, n in driver.clips.items()},
        )
        self._desk.published(state.seq)
        self._published_ns = self._clock.now_ns()
        packed = pack_state(state, info)
        self._channel.send(Note("state", info.token, self.boot, packed))
        name = state.fault
        if (
            name != self._told_fault[0]
            or self._published_ns - self._told_fault[1] > _FAULT_EVERY_NS
        ):
            self._channel.send(Note("fault", 0, self.boot, packed))
            self._told_fault = (name, self._published_ns)
        if self._tick_log is not None:
            self._tick_log.add(state, info, self._published_ns)

    def _slow(self) -> None:
        self._heartbeat.set_deadline(SLOW_S)
        self._was_slow = True

    def _timing(self) -> dict[str, Any]:
        late = np.percentile(self._late, [50, 99]) if self._late else (0.0, 0.0)
        return {
            "tick_late_p50_ms": float(late[0]),
            "tick_late_p99_ms": float(late[1]),
            "tick_overruns": self._overruns,
            "ticks_not_logged": 0 if self._tick_log is None else self._tick_log.lost,
        } | self._desk.timing()
