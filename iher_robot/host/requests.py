"""Answers the requests of clients: description, status, lease, arm, reset, stop, clear fault."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any

from drivers.command import ResetOutcome, ResetRequest
from drivers.errors import DriverError, HandsNotClear, InvalidRequest, LeaseRefused, LinkLost
from drivers.remote.messages import (
    ArmRequest,
    ClearFaultRequest,
    Empty,
    Leased,
    LeaseRequest,
    Ping,
    Reply,
    ResetMessage,
    SpecRequest,
    StopRequest,
)
from drivers.wire import WireError, pack, unpack
from iher_robot.errors import UserError
from iher_robot.host.commands import CommandHandler
from iher_robot.host.lease import HostLease, SilenceTimer
from iher_robot.host.persistence import RobotTotal
from iher_robot.host.served_robot import ServedRobot
from iher_robot.storage.robot_time import RobotTime
from iher_robot.version import __version__

log = logging.getLogger(__name__)

Result = dict[str, Any]

_LONGEST_RESET_S = 120.0
"""Robot time that is reserved for a reset."""


class RequestHandler:
    """Answers requests between two ticks, and a stop at any time.

    Args:
        boot: Identifies this start of the host.
        robot: The robot.
        lease: The lease of the client that may command.
        commands: Handler of the commands.
        deadman: Restarted when the robot is armed.
        total: The robot's own account of ticks.
        fixed_scene: The only scene that is served, None for any.
        status: Returns what the control loop adds to `status`.
        slow: Called before anything that takes longer than a tick.
    """

    def __init__(
        self,
        *,
        boot: str,
        robot: ServedRobot,
        lease: HostLease,
        commands: CommandHandler,
        deadman: SilenceTimer,
        total: RobotTotal,
        fixed_scene: str | None,
        status: Callable[[], Result],
        slow: Callable[[], None],
    ) -> None:
        self._boot = boot
        self._robot = robot
        self._lease = lease
        self._commands = commands
        self._deadman = deadman
        self._total = total
        self._fixed_scene = fixed_scene
        self._status_of_loop = status
        self._slow = slow
        self._seq = 0
        self.disarmed_because = ""
        self._handlers: dict[str, Callable[[bytes], Result]] = {
            "spec": self._spec,
            "status": self._status,
            "ping": self._ping,
            "stop": self.stop,
            "lease": self._change_lease,
            "arm": self._arm,
            "disarm": self._disarm,
            "reset": self._reset,
            "hands_clear": self._hands_clear,
            "clear_fault": self._clear_fault,
        }

    def answer(self, name: str, body: bytes) -> bytes:
        """Answer a request.

        Args:
            name: Name of the request.
            body: The packed message.

        Returns:
            A packed `Reply`.
        """
        try:
            if name not in self._handlers:
                known = ", ".join(sorted(self._handlers))
                raise InvalidRequest(f"request {name!r:.40} is unknown, valid: {known}")
            result = self._handlers[name](body)
        except WireError as error:
            self._commands.refuse(f"request_{error.reason}")
            return self._reply(InvalidRequest(f"request {name!r} cannot be read: {error}"))
        except (DriverError, UserError) as error:
            self._commands.refuse("request_refused")
            return self._reply(error)
        return self._reply(None, result)

    def stop(self, body: bytes) -> Result:
        """Stop the robot and latch the fault. Thread-safe."""
        request = unpack(StopRequest, body)
        self._robot.stop(request.reason, request.fault)  # on disk before it is acknowledged
        return {}

    def published(self, seq: int) -> None:
        """Record the sequence of the newest state, which every reply carries."""
        self._seq = seq

    def disarm(self, because: str) -> None:
        """Disarm the robot by decision of the host, for a reason that clients can read."""
        self._robot.driver.disarm()
        self.disarmed_because = because

    def _spec(self, body: bytes) -> Result:
        scene = unpack(SpecRequest, body).scene or self._robot.scene
        return {"spec": self._describe(scene).to_dict(), "scene": scene}

    def _ping(self, body: bytes) -> Result:
        return {"payload": unpack(Ping, body).payload}

    def _status(self, body: bytes) -> Result:
        unpack(Empty, body)
        driver = self._robot.driver
        fault = driver.fault
        return {
            "version": __version__,
            "robot": self._robot.spec.name,
            "scene": self._robot.scene,
            "mode": str(self._robot.state().mode),
            "armed": driver.is_armed,
            "disarmed_because": self.disarmed_because,
            "fault": None if fault is None else {"name": fault.name, "reason": fault.reason},
            "holder": self._lease.holder,
            "refusals": dict(self._commands.refusals),
            "clips": {str(reason): n for reason, n in driver.clips.items()},
            "total_ticks": self._total.spent(),
            "control_period_s": self._robot.spec.control_period_s,
            "deadman_s": self._deadman.limit_s,
        } | self._status_of_loop()

    def _change_lease(self, body: bytes) -> Result:
        request = unpack(LeaseRequest, body)
        if request.op == "acquire":
            scene = request.scene or self._robot.scene
            self._describe(scene)  # before anything changes
            if scene != self._robot.scene and self._robot.driver.after_human_help:
                raise HandsNotClear(
                    f"{self._robot.spec.name} needed a human; confirm that hands are clear and "
                    "reset it before changing the scene"
                )
            token = self._lease.acquire(request.session, request.holder)
            self.disarm("")  # the client that had it before may have left it armed
            if scene != self._robot.scene:
                self._slow()
                self._robot.change_scene(scene)
                self._commands.forget()
                self._lease.renew()  # the time of loading does not count
            return {"token": token, "ttl_s": self._lease.ttl_s}
        self._lease.require(request.token)
        if request.op == "release":
            self.disarm("")
            self._lease.release()
        return {}

    def _arm(self, body: bytes) -> Result:
        request = unpack(ArmRequest, body)
        self._require(request)
        driver = self._robot.driver
        driver.limit_speed(request.speed)
        self._total.reserve("motion")  # no motion without a tick that can be counted
        driver.arm()
        self.disarmed_because = ""
        self._deadman.restart()
        return {}

    def _disarm(self, body: bytes) -> Result:
        self._require(unpack(Leased, body))
        self.disarm("")
        return {}

    def _reset(self, body: bytes) -> Result:
        request = unpack(ResetMessage, body)
        self._require(request)
        places = {}
        for name, place in request.objects.items():
            if len(place) != 2:
                raise InvalidRequest(f"{name!r} is placed at {place!r:.60}, allowed: [x, y] in m")
            places[name] = (place[0], place[1])
        self._slow()
        self._robot.driver.limit_speed(request.speed)
        before = self._robot.state().stamp_ns
        period_s = self._robot.spec.control_period_s
        longest = RobotTime.from_seconds(_LONGEST_RESET_S, period_s)
        with self._total.reserve_at_most("reset", longest.ticks) as entry:
            try:
                result = self._robot.reset(ResetRequest(places, request.seed))
            finally:  # a reset that failed may have moved the robot, too
                self._commands.forget()
                self._lease.renew()
                after = self._robot.state()
                entry.settle(RobotTime.from_ns(after.stamp_ns - before, period_s).ticks)
        self.published(after.seq)
        if result.outcome is ResetOutcome.FAILED:
            log.warning("reset of %s failed: %s", self._robot.spec.name, result.message)
        return {"outcome": str(result.outcome), "message": result.message}

    def _hands_clear(self, body: bytes) -> Result:
        self._require(unpack(Leased, body))
        self._robot.driver.confirm_hands_clear()
        return {}

    def _clear_fault(self, body: bytes) -> Result:
        name = unpack(ClearFaultRequest, body).name
        self._robot.driver.clear_fault(name)
        self._robot.save_fault()
        log.warning("fault %r of %s is cleared", name, self._robot.spec.name)
        return {}

    def _describe(self, scene: str) -> Any:
        if self._fixed_scene is not None and scene != self._fixed_scene:
            raise InvalidRequest(
                f"{self._robot.spec.name} is served in scene {self._fixed_scene!r} only, not "
                f"{scene!r:.40}; start its host with another --scene"
            )
        if not self._robot.has_described(scene):
            if self._robot.driver.is_armed:  # loading it would block the control loop
                raise LeaseRefused(
                    f"scene {scene!r:.40} of {self._robot.spec.name} is not loaded, and the robot "
                    f"is used by {self._lease.holder}; try again when it is disarmed"
                )
            self._slow()
        return self._robot.describe(scene)

    def _require(self, request: Leased) -> None:
        if request.boot != self._boot:
            raise LinkLost(
                f"the host of {self._robot.spec.name} was restarted; open the robot again"
            )
        self._lease.require(request.token)

    def _reply(self, error: Exception | None, result: Mapping[str, Any] | None = None) -> bytes:
        reply = Reply(
            ok=error is None,
            error="" if error is None else type(error).__name__,
            message="" if error is None else str(error)[:4000],
            boot=self._boot,
            seq=self._seq,
            result={} if result is None else dict(result),
        )
        return pack(reply)
