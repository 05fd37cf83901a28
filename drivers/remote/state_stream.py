"""Statistics of the stream of a robot's states: rate, jitter, losses."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from drivers.remote.client import RobotClient
from drivers.remote.state_message import unpack_state
from drivers.spec import RobotSpec
from drivers.state import RobotState
from drivers.wire import WireError


@dataclass(frozen=True)
class StateStream:
    """The states received in a period.

    Attributes:
        count: Number of states received.
        lost: Number of ticks in between without a state.
        malformed: Number of messages that are no state of this robot.
        rate_hz: States per second.
        jitter_ms: Standard deviation of the time between two states.
        newest: The last state, None without one.
        received_ns: Its time of receipt, on the clock of its stamps.
    """

    count: int
    lost: int
    malformed: int
    rate_hz: float
    jitter_ms: float
    newest: RobotState | None
    received_ns: int


class StateListener:
    """Records when states arrive.

    Args:
        spec: The robot.
    """

    def __init__(self, spec: RobotSpec) -> None:
        self._spec = spec
        self._seqs: list[int] = []
        self._times_ns: list[int] = []
        self._newest: RobotState | None = None
        self._malformed = 0
        self._lock = threading.Lock()

    def take(self, data: bytes, received_ns: int) -> None:
        """Take a message.

        Args:
            data: A packed state.
            received_ns: Time of receipt, on this machine's clock.
        """
        try:
            state, _ = unpack_state(data, self._spec, received_ns)
        except WireError:
            with self._lock:
                self._malformed += 1
            return
        with self._lock:
            self._newest = state
            self._seqs.append(state.seq)
            self._times_ns.append(received_ns)

    def result(self, skipped: int = 0) -> StateStream:
        """Return the statistics so far.

        Args:
            skipped: Ticks for which no state was published, as in a reset.
        """
        with self._lock:
            seqs, times_ns = list(self._seqs), np.array(self._times_ns, dtype=np.int64)
            newest, malformed = self._newest, self._malformed
        count = len(seqs)
        gaps_ms = np.diff(times_ns) / 1e6
        span_ms = float(gaps_ms.sum())
        expected = max(seqs) - min(seqs) + 1 if seqs else 0
        return StateStream(
            count=count,
            lost=max(0, expected - len(set(seqs)) - skipped),
            malformed=malformed,
            rate_hz=1e3 * (count - 1) / span_ms if span_ms > 0 else 0.0,
            jitter_ms=float(gaps_ms.std()) if len(gaps_ms) else 0.0,
            newest=newest,
            received_ns=int(times_ns[-1]) if count else 0,
        )


def listen_to_states(client: RobotClient, spec: RobotSpec) -> StateListener:
    """Start to receive the states of a robot.

    Args:
        client: Session with its host.
        spec: The robot.
    """
    listener = StateListener(spec)
    client.listen(listener.take)
    return listener
