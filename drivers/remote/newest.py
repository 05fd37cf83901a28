"""The newest state of a remote robot, with a way to wait for a newer one."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from drivers.remote.state_message import HostInfo, unpack_state
from drivers.spec import RobotSpec
from drivers.state import RobotState
from drivers.wire import WireError

log = logging.getLogger(__name__)

Received = tuple[RobotState, HostInfo]


class NewestState:
    """Keeps the newest state received; older states that arrive late are dropped.

    Args:
        spec: The robot.
        on_arrival: Called with each new state, before the threads that wait for it wake.
    """

    def __init__(self, spec: RobotSpec, on_arrival: Callable[[RobotState, HostInfo], None]) -> None:
        self._spec = spec
        self._on_arrival = on_arrival
        self._changed = threading.Condition()
        self._newest: Received | None = None
        self._wakes = 0
        self.malformed = 0
        """Number of malformed states."""

    @property
    def value(self) -> Received | None:
        """The newest state, None before the first."""
        return self._newest

    def take(self, data: bytes, received_ns: int) -> None:
        """Take a message.

        Args:
            data: A packed state.
            received_ns: Time of receipt, on this machine's clock.
        """
        try:
            state, info = unpack_state(data, self._spec, received_ns)
        except WireError as error:
            self.malformed += 1
            if self.malformed == 1:
                log.warning("a state of %s cannot be read: %s", self._spec.name, error)
            return
        with self._changed:
            known = self._newest
            if known is not None and known[1].boot == info.boot and state.seq <= known[0].seq:
                return
            self._on_arrival(state, info)
            self._newest = (state, info)
            self._changed.notify_all()

    def wait(
        self, wanted: Callable[[RobotState, HostInfo], bool], timeout_s: float
    ) -> Received | None:
        """Wait for a state.

        Args:
            wanted: Whether a state ends the wait.
            timeout_s: Longest time to wait.

        Returns:
            The state, or None after the timeout or a call of `wake`.
        """
        deadline = time.monotonic() + timeout_s
        with self._changed:
            wakes = self._wakes
            while self._newest is None or not wanted(*self._newest):
                left_s = deadline - time.monotonic()
                if left_s <= 0 or self._wakes != wakes:
                    return None
                self._changed.wait(left_s)
            return self._newest

    def wake(self) -> None:
        """Make every `wait` in progress return."""
        with self._changed:
            self._wakes += 1
            self._changed.notify_all()
