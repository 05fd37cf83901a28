"""The contract between a robot and everything above it."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from typing import ClassVar, Self

from drivers.clock import Clock, MonotonicClock, SimulatedClock
from drivers.closing import Closing
from drivers.command import (
    Acceptance,
    Command,
    Refusal,
    ResetOutcome,
    ResetRequest,
    ResetResult,
)
from drivers.errors import (
    HandsNotClear,
    InvalidRequest,
    LifecycleError,
    StaleState,
)
from drivers.gate import Fault
from drivers.hooks import RobotHooks
from drivers.safety import SafetyFilter
from drivers.spec import RobotSpec
from drivers.state import JointSetpoint, Mode, RobotState

log = logging.getLogger(__name__)

EMERGENCY_STOP = "emergency_stop"


class RobotDriver(RobotHooks, Closing):
    """A robot, simulated or real. This text is the contract.

    **Description.** `spec` needs no connection. Two digests in it stand for the robot: the
    interface must match between a policy and a robot, a different body is for a person to
    accept. A physical robot must declare after which silence it holds by itself.

    **Lifecycle.** ``open -> arm -> (read | command | advance)* -> disarm -> close``; `reset`
    belongs between `open` and `arm`. A call out of order raises `LifecycleError`. *Held*
    means powered with zero motion; *disarmed* means that the command gate is closed.
    Neither ever de-energises a joint. `disarm`, `stop` and `close` are idempotent and may
    come from any thread. A context manager opens, and always ends held and disarmed, even
    when its body or a hook raises; an `open` that fails leaves nothing connected. Arm per
    episode, disarm for learning phases.

    **Stop.** `stop` closes the gate at once, without waiting for a tick in progress, holds,
    and latches: it survives `close` and every attempt to arm. Only `clear_fault`, by the
    name of the fault, unlatches, and clearing never arms. This is not a safety-rated stop.

    **States.** `read` returns a `RobotState` or raises `StaleState`, for the robot's own
    measurement and for each object by the age limit of its own sensor. `seq` is the robot's
    tick counter and never decreases. `applied` is the last command that was applied.

    **Commands.** `command` hands over a target and returns acceptance only; what was applied
    arrives in the next state. Every command passes the `SafetyFilter` on the robot's side:
    what exceeds a limit is cut, as a whole, and `AppliedCommand.clipped` and `clips` say why.
    A joint command starts from `RobotState.setpoint`, and so does a controller. What a
    correct controller can meet (disarmed, latched, expired, a state from before a reset) is a
    refusal, returned and counted in `refusals`; what is a bug (a kind that the spec does not
    declare, a wrong shape, a value that is not finite) raises `InvalidCommand`. Of several
    commands in a tick the last accepted one counts. A tick without an accepted command is held:
    that is the deadman.

    **Time.** The robot's side owns time and the tick counter. `advance` ends the control
    tick: a simulator steps its physics, a robot waits for its next tick. No time stamp is
    compared across machines: a command names the state that it answers, and expires by that
    state's age on the robot's clock (`limits.watchdog_s`).

    **Reset.** `reset` returns done, needs a human, or failed. After a reset that needs a human
    nothing moves until `confirm_hands_clear`, and then everything moves at reduced speed
    (`speed_scale`) until a reset is done.

    Implementers write the hooks of `RobotHooks`; this class calls them one at a time, under
    a lock, and only where the lifecycle allows.
    """

    exclusive: ClassVar[bool] = False
    """Whether two drivers of this class with the same options move the same robot."""

    def __init__(
        self, spec: RobotSpec, clock: Clock | None = None, safety: SafetyFilter | None = None
    ) -> None:
        """Prepare the driver, without a connection.

        Args:
            spec: Description of the robot.
            clock: The robot's clock; the machine's monotonic clock by default.
            safety: Checks and limits commands; a `SafetyFilter` of the spec by default. Only the
                driver of a robot that is filtered on the other side of a link passes another.

        Raises:
            InvalidSpec: If the robot takes joint commands and its kinematic model cannot be used.
        """
        self._spec = spec
        self._clock: Clock = MonotonicClock() if clock is None else clock
        self._hooks = threading.RLock()  # held while a hook runs, up to a whole tick
        self._safety = SafetyFilter(spec, self._clock) if safety is None else safety
        self._gate = self._safety.gate
        self._open_now = False
        self._hands_clear = True
        self._speed_scale = 1.0
        self._speed_limit = 1.0

    # Properties, available at any time

    @property
    def spec(self) -> RobotSpec:
        """The robot's description."""
        return self._spec

    @property
    def is_open(self) -> bool:
        """Whether there is a connection."""
        return self._open_now

    @property
    def is_armed(self) -> bool:
        """Whether the command gate is open."""
        return self._gate.armed

    @property
    def fault(self) -> Fault | None:
        """The latched fault, None without one."""
        return self._gate.fault

    @property
    def disarmed_because(self) -> str:
        """Why the robot's side closed the gate by itself, empty if it did not."""
        return ""

    @property
    def refusals(self) -> Mapping[Refusal, int]:
        """How many commands were refused, by reason, since construction."""
        return self._gate.refusals

    @property
    def clips(self) -> Mapping[str, int]:
        """How many commands were cut by a limit, by reason, since construction."""
        return self._safety.clips

    @property
    def speed_scale(self) -> float:
        """Share of full speed that is allowed now. It scales motions as a whole."""
        return min(self._speed_scale, self._speed_limit)

    @property
    def after_human_help(self) -> bool:
        """Whether a reset needed a human, and none was done since."""
        return not self._hands_clear or self._speed_scale < 1.0

    @property
    def paces_itself(self) -> bool:
        """Whether `advance` takes as long as a tick; a simulation runs as fast as possible."""
        return not isinstance(self._clock, SimulatedClock)

    @property
    def now_ns(self) -> int:
        """Time on the robot's clock, the clock of its states' stamps."""
        return self._clock.now_ns()

    def limit_speed(self, share: float) -> None:
        """Limit every speed to a share of full speed, until the next call.

        Args:
            share: Above 0 and up to 1; 1 removes the limit.

        Raises:
            InvalidRequest: If the share is out of range.
            LifecycleError: If the robot is armed: its speed would jump.
        """
        if not 0.0 < share <= 1.0:
            raise InvalidRequest(
                f"speed limit of {self.spec.name} is {share}, allowed: above 0 and up to 1"
            )
        with self._hooks:
            if self._gate.armed:
                raise LifecycleError(
                    f"limit_speed on {self.spec.name}, which is armed; disarm it first"
                )
            self._speed_limit = float(share)

    # Lifecycle

    def open(self) -> None:
        """Connect. The robot is held and disarmed afterwards.

        Raises:
            LifecycleError: If it is already open.
        """
        with self._hooks:
            if self._open_now:
                raise LifecycleError(f"{self.spec.name} is already open; close it first")
            try:
                self._open()
                self._gate.forget_states()
                self._open_now = True
            except BaseException as error:
                self._abandon(error)
                raise

    def arm(self) -> None:
        """Open the command gate. The robot stays held until the first command.

        Raises:
            LifecycleError: If the driver is not open, or is already armed.
            FaultLatched: If a fault is latched.
            HandsNotClear: If a reset needed a human and hands are not confirmed clear.
        """
        with self._hooks:
            self._require_motion("arm")
            self._prepare_to_arm()
            self._gate.arm()

    def disarm(self) -> None:
        """Close the command gate and hold. Idempotent, from any thread."""
        self._gate.disarm()
        with self._hooks:
            self._gate.disarm()  # an arm in progress may have opened it meanwhile
            if self._open_now:
                self._hold()

    def close(self) -> None:
        """Disarm, hold and disconnect. Idempotent, from any thread; a fault stays latched."""
        self._gate.disarm()  # at once, without waiting for a tick in progress
        with self._hooks:
            self._gate.disarm()  # an arm in progress may have opened it meanwhile
            if not self._open_now:
                return
            try:
                self._hold()
            finally:  # a robot that cannot be held is still disconnected: it holds on silence
                self._open_now = False
                self._close()

    def stop(self, reason: str, fault: str = EMERGENCY_STOP) -> None:
        """Stop and latch. Idempotent, from any thread, in any state; the first stop is kept.

        Args:
            reason: What happened, for people.
            fault: Name of the fault that is latched.
        """
        self._gate.latch(fault, reason)
        log.warning("%s stopped: %s", self.spec.name, reason)
        try:
            self._interrupt()
        finally:  # without `_interrupt` the robot holds at the end of the hook in progress
            with self._hooks:
                if self._open_now:
                    self._hold()

    def clear_fault(self, name: str) -> None:
        """Unlatch a fault, on behalf of an operator. Never arms.

        Args:
            name: Name of the latched fault.

        Raises:
            LifecycleError: If another fault, or none, is latched.
        """
        self._gate.clear(name)

    def __enter__(self) -> Self:
        if not self._open_now:
            self.open()
        return self

    # The control tick

    def read(self, max_age_s: float | None = None) -> RobotState:
        """Return the newest measurement.

        Args:
            max_age_s: Greatest age accepted; the spec's watchdog by default. For objects the age
                limit of their own sensor applies.

        Raises:
            InvalidRequest: If the age is negative or not a number.
            LifecycleError: If the driver is not open.
            StaleState: If the measurement, or that of an object, is older.
        """
        limit_s = self.spec.limits.watchdog_s if max_age_s is None else max_age_s
        if not limit_s >= 0:  # also for nan, above which no age is
            raise InvalidRequest(
                f"max_age_s of read on {self.spec.name} is {limit_s}, allowed: 0 s or more"
            )
        with self._hooks:
            self._require_open("read")
            state = self._read()
            now_ns = self._clock.now_ns()
            self._require_fresh("state", state.stamp_ns, now_ns, limit_s)
            for name, pose in state.objects.items():
                limit_s = self.spec.objects[name].max_age_s
                self._require_fresh(f"object {name!r}", pose.stamp_ns, now_ns, limit_s)
            self._gate.remember(state)
            return state

    def measure(self) -> RobotState:
        """Return the newest measurement, however old it and its objects are.

        For a host, whose clients check the ages; other callers use `read`.

        Raises:
            LifecycleError: If the driver is not open.
        """
        with self._hooks:
            self._require_open("measure")
            state = self._read()
            self._gate.remember(state)
            return state

    def command(self, command: Command) -> Acceptance:
        """Set the target of this tick.

        Args:
            command: The target, of a kind that the spec declares.

        Returns:
            Acceptance only: what was applied arrives in the next state.

        Raises:
            LifecycleError: If the driver is not open.
            InvalidCommand: If this robot can never execute it.
        """
        self._safety.check(command)
        with self._hooks:
            self._require_open("command")
            state = self._read()
            judgement = self._safety.judge(command, state)
            if judgement.accepted:
                self._apply(*self._safety.limit(command, state, self.speed_scale))
            return judgement

    def advance(self) -> None:
        """End the control tick. Without an accepted command the tick is held.

        Raises:
            LifecycleError: If the driver is not open.
        """
        with self._hooks:
            self._require_open("advance")
            if not self._gate.armed:  # also when a stop still waits for the lock of the hooks
                self._hold()
            self._advance()

    def reset(self, request: ResetRequest) -> ResetResult:
        """Go home and put the objects in place. States from before cannot be answered any more.

        Args:
            request: Where the objects should be.

        Returns:
            Done, needs a human, or failed.

        Raises:
            LifecycleError: If the driver is not open, or is armed.
            FaultLatched: If a fault is latched.
            HandsNotClear: If a reset needed a human and hands are not confirmed clear.
            InvalidRequest: If the request names an object that the robot does not have, or a
                place where no object can be.
        """
        with self._hooks:
            self._require_motion("reset")
            unknown = request.objects.keys() - self.spec.objects.keys()
            if unknown:
                raise InvalidRequest(
                    f"reset names {sorted(unknown)}, objects of {self.spec.name}: "
                    f"{sorted(self.spec.objects)}"
                )
            self._gate.forget_states()
            result = self._reset(request)
            if result.outcome is ResetOutcome.NEEDS_HUMAN:
                self._hands_clear = False
            elif result.outcome is ResetOutcome.DONE:
                self._speed_scale = 1.0
            return result

    def expect_human(self) -> None:
        """Require that hands are confirmed clear before any motion.

        For a host that restarts after a reset needed a human.
        """
        with self._hooks:
            self._hands_clear = False

    def confirm_hands_clear(self) -> None:
        """Confirm that no person is in reach, after a reset that needed a human.

        Until a reset is done, motion is at reduced speed.

        Raises:
            LifecycleError: If no reset needed a human.
        """
        with self._hooks:
            if self._hands_clear:
                raise LifecycleError(f"{self.spec.name} needed no human; nothing to confirm")
            self._hands_confirmed()
            self._hands_clear = True
            self._speed_scale = self.spec.limits.reduced_speed_scale

    # For implementations

    def _brake(self, setpoint: JointSetpoint) -> JointSetpoint:
        """Return the setpoint at the end of a tick of braking, for a tick without a command."""
        return self._safety.brake(setpoint)

    def _abandon(self, error: BaseException) -> None:
        """Hold and disconnect after an `_open` that failed."""
        self._open_now = False
        try:
            self._attempt(self._hold, error)
        finally:
            self._attempt(self._close, error)

    def _attempt(self, hook: Callable[[], None], error: BaseException) -> None:
        try:
            hook()
        except Exception as failure:  # noqa: BLE001 - the first error is the one raised
            error.add_note(f"{hook.__name__} on {self.spec.name} also failed: {failure!r}")

    def _mode(self, moving: bool) -> Mode:
        """Return the mode, given whether the robot follows a command."""
        if self._gate.fault is not None:
            return Mode.STOPPED
        if not self._gate.armed:
            return Mode.DISARMED
        return Mode.MOVING if moving else Mode.HELD

    def _require_open(self, call: str) -> None:
        if not self._open_now:
            raise LifecycleError(f"{call} on {self.spec.name}, which is not open; open it first")

    def _require_motion(self, call: str) -> None:
        self._require_open(call)
        if self._gate.armed:
            raise LifecycleError(f"{call} on {self.spec.name}, which is armed; disarm it first")
        self._gate.require_no_fault()
        if not self._hands_clear:
            raise HandsNotClear(
                f"{call} on {self.spec.name} after human help; call confirm_hands_clear first"
            )

    def _require_fresh(self, what: str, stamp_ns: int, now_ns: int, limit_s: float) -> None:
        age_s = (now_ns - stamp_ns) / 1e9
        if age_s > limit_s:
            raise StaleState(
                f"{what} of {self.spec.name} is {age_s:.3f} s old, allowed: {limit_s} s"
            )
