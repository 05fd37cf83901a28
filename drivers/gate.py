"""The command gate: armed or not, the latched fault, and the age of the states answered."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from drivers.clock import Clock
from drivers.command import Acceptance, Command, Refusal
from drivers.errors import FaultLatched, LifecycleError
from drivers.spec import RobotSpec
from drivers.state import RobotState
from drivers.state_ages import StateAges


@dataclass(frozen=True)
class Fault:
    """A latched fault.

    Attributes:
        name: Name by which it is cleared.
        reason: What happened, for people.
        stamp_ns: When it was latched, on the robot's clock.
    """

    name: str
    reason: str
    stamp_ns: int


class CommandGate:
    """Accepts commands only while armed, without a fault, and in answer to a fresh state.

    Its lock is never held for a whole tick, so that a stop from another thread takes effect at
    once.
    """

    def __init__(self, spec: RobotSpec, clock: Clock) -> None:
        self._spec = spec
        self._clock = clock
        self._lock = threading.Lock()
        self._armed = False
        self._fault: Fault | None = None
        self._ages = StateAges(clock)
        self._refusals: Counter[Refusal] = Counter()

    @property
    def armed(self) -> bool:
        """Whether the gate is open."""
        return self._armed

    @property
    def fault(self) -> Fault | None:
        """The latched fault, None without one."""
        return self._fault

    @property
    def refusals(self) -> Mapping[Refusal, int]:
        """How many commands were refused, by reason."""
        return dict(self._refusals)

    def arm(self) -> None:
        """Open the gate.

        Raises:
            FaultLatched: If a fault is latched.
        """
        with self._lock:  # a stop from another thread falls before or after, never between
            self.require_no_fault()
            self._armed = True

    def disarm(self) -> None:
        """Close the gate."""
        with self._lock:
            self._armed = False

    def latch(self, name: str, reason: str) -> None:
        """Close the gate until the fault is cleared. The first fault is kept.

        Args:
            name: Name by which it is cleared.
            reason: What happened, for people.
        """
        with self._lock:
            self._armed = False
            if self._fault is None:
                self._fault = Fault(name, reason, self._clock.now_ns())

    def clear(self, name: str) -> None:
        """Unlatch a fault; the gate stays closed.

        Args:
            name: Name of the latched fault.

        Raises:
            LifecycleError: If another fault, or none, is latched.
        """
        with self._lock:
            latched = None if self._fault is None else self._fault.name
            if latched is None or latched != name:
                raise LifecycleError(
                    f"fault {name!r} is not latched on {self._spec.name}, latched: {latched!r}"
                )
            self._fault = None

    def require_no_fault(self) -> None:
        """Raise `FaultLatched` if a fault is latched."""
        if self._fault is not None:
            raise FaultLatched(
                f"{self._spec.name} is stopped by {self._fault.name!r} ({self._fault.reason}); "
                "an operator must clear the fault by that name"
            )

    def remember(self, state: RobotState) -> None:
        """Record a state that was read; from now on commands may answer it."""
        self._ages.add(state.seq, state.stamp_ns)

    def forget_states(self) -> None:
        """Refuse answers to all states read so far."""
        self._ages.clear()

    def judge(self, command: Command) -> Acceptance:
        """Accept or refuse a command; refusals are counted.

        Args:
            command: A valid command.
        """
        judgement = self._judge(command)
        if judgement.refusal is not None:
            return self.refuse(judgement.refusal, judgement.message)
        return judgement

    def refuse(self, refusal: Refusal, message: str) -> Acceptance:
        """Refuse a command, and count it.

        Args:
            refusal: The reason.
            message: The reason with values, for people.
        """
        self._refusals[refusal] += 1
        return Acceptance(refusal, message)

    def _judge(self, command: Command) -> Acceptance:
        fault = self._fault
        if fault is not None:
            return Acceptance(Refusal.LATCHED, f"stopped by {fault.name!r} ({fault.reason})")
        if not self._armed:
            return Acceptance(Refusal.DISARMED, "the command gate is closed; arm first")
        age_ns = self._ages.age_ns(command.answers)
        if age_ns is None:
            return Acceptance(
                Refusal.UNKNOWN_STATE,
                f"answers state {command.answers}, newest read since the reset: "
                f"{self._ages.newest}",
            )
        age_s = age_ns / 1e9
        limit_s = self._spec.limits.watchdog_s
        if age_s > limit_s:
            return Acceptance(
                Refusal.EXPIRED,
                f"answers state {command.answers}, {age_s:.3f} s old, allowed: {limit_s} s",
            )
        return _ACCEPTED


_ACCEPTED = Acceptance()
