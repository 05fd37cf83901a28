"""Ages of the newest states of a robot, which decide whether a command that answers one expired."""

from __future__ import annotations

from drivers.clock import Clock

_MAX_STATES = 64


class StateAges:
    """Time stamps of the newest 64 states, by sequence. States that were dropped have no age."""

    def __init__(self, clock: Clock) -> None:
        """Start without a state.

        Args:
            clock: The clock of the stamps.
        """
        self._clock = clock
        self._stamps: dict[int, int] = {}

    @property
    def newest(self) -> int | None:
        """Sequence of the state added last, None without one."""
        return next(reversed(self._stamps), None)

    def add(self, seq: int, stamp_ns: int) -> None:
        """Add a state; beyond 64 the oldest is dropped.

        Args:
            seq: Sequence of the state.
            stamp_ns: When its age was 0.
        """
        self._stamps[seq] = stamp_ns
        if len(self._stamps) > _MAX_STATES:
            del self._stamps[next(iter(self._stamps))]

    def clear(self) -> None:
        """Drop every state."""
        self._stamps.clear()

    def age_ns(self, seq: int) -> int | None:
        """Return the age of a state now, None for a state that is not among them."""
        stamp_ns = self._stamps.get(seq)
        return None if stamp_ns is None else self._clock.now_ns() - stamp_ns
