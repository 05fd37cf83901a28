"""Who may command a robot: one client at a time, for as long as it is heard of."""

from __future__ import annotations

from drivers import LeaseRefused
from drivers.clock import Clock


class HostLease:
    """The lease of a robot, given by the host with a token that rises: the newest one counts.

    Attributes:
        token: Of the lease in force, 0 for none.
        holder: Who has it, in words.
        n: Number of its last command that was dealt with.
    """

    def __init__(self, name: str, ttl_s: float, clock: Clock) -> None:
        """Begin without a lease.

        Args:
            name: Of the robot.
            ttl_s: Silence after which it ends.
            clock: The host's.
        """
        self.token = 0
        self.holder = ""
        self.n = 0
        self.ttl_s = ttl_s
        self._name = name
        self._clock = clock
        self._given = 0
        self._session = ""
        self._heard_ns = 0

    def acquire(self, session: str, holder: str) -> int:
        """Give the lease to a client; one that has it gets a new token.

        Args:
            session: Stands for the client.
            holder: Who it is, in words.

        Returns:
            The token.

        Raises:
            LeaseRefused: Somebody else has it.
        """
        if self.token and session != self._session:
            left_s = self.ttl_s - self._silence_s()
            raise LeaseRefused(
                f"robot {self._name!r} is used by {self.holder} now, until that client ends or is "
                f"silent for {max(0.0, left_s):.1f} s more; wait for it, or stop it"
            )
        self._given += 1
        self.token, self._session, self.holder, self.n = self._given, session, holder, 0
        self.heard()
        return self.token

    def require(self, token: int) -> None:
        """Refuse everybody but the client that has the lease, and note that it was heard of.

        Raises:
            LeaseRefused: The token is not that of the lease in force.
        """
        if not self.token or token != self.token:
            now = f"it is used by {self.holder} now" if self.token else "it has ended"
            raise LeaseRefused(
                f"lease {token} of robot {self._name!r} is not in force: {now}; open it again"
            )
        self.heard()

    def heard(self) -> None:
        """Note that the client was heard of."""
        self._heard_ns = self._clock.now_ns()

    def release(self) -> None:
        """End the lease."""
        self.token, self.holder, self._session, self.n = 0, "", "", 0

    def expire(self) -> bool:
        """End the lease of a client that was silent for too long.

        Returns:
            Whether it ended now.
        """
        if not self.token or self._silence_s() <= self.ttl_s:
            return False
        self.release()
        return True

    def _silence_s(self) -> float:
        return (self._clock.now_ns() - self._heard_ns) / 1e9


class Deadman:
    """Notices that an armed client has fallen silent.

    Args:
        limit_s: Silence that is too long.
        clock: The host's.
    """

    def __init__(self, limit_s: float, clock: Clock) -> None:
        self.limit_s = limit_s
        self._clock = clock
        self._heard_ns = clock.now_ns()

    def heard(self) -> None:
        """Note that the client was heard of."""
        self._heard_ns = self._clock.now_ns()

    @property
    def tripped(self) -> bool:
        """Whether the client is silent for too long."""
        return (self._clock.now_ns() - self._heard_ns) / 1e9 > self.limit_s
