"""The lease of a robot, for one client at a time, and the timer that detects a silent client."""

from __future__ import annotations

from drivers import LeaseRefused
from drivers.clock import Clock


class SilenceTimer:
    """Expires when a client sent nothing for too long; the deadman is one.

    Args:
        limit_s: Longest silence that is allowed.
        clock: The host's.
    """

    def __init__(self, limit_s: float, clock: Clock) -> None:
        self.limit_s = limit_s
        self._clock = clock
        self._restarted_ns = clock.now_ns()

    def restart(self) -> None:
        """Start again from zero: the client sent something."""
        self._restarted_ns = self._clock.now_ns()

    @property
    def silence_s(self) -> float:
        """Time since the client last sent something."""
        return (self._clock.now_ns() - self._restarted_ns) / 1e9

    @property
    def expired(self) -> bool:
        """Whether the client has been silent for longer than the limit."""
        return self.silence_s > self.limit_s


class HostLease:
    """The right to command a robot, with a token that rises: only the newest token is valid.

    Attributes:
        token: Token of the lease in force, 0 for none.
        holder: Name of the client that has it.
        n: Number of its last command that was processed.
        ttl_s: Silence of the client after which it ends.
    """

    def __init__(self, name: str, ttl_s: float, clock: Clock) -> None:
        """Start without a lease.

        Args:
            name: Name of the robot.
            ttl_s: Silence of a client after which its lease ends.
            clock: The host's.
        """
        self.token = 0
        self.holder = ""
        self.n = 0
        self.ttl_s = ttl_s
        self._name = name
        self._timer = SilenceTimer(ttl_s, clock)
        self._last_token = 0
        self._session = ""

    def acquire(self, session: str, holder: str) -> int:
        """Give the lease to a client; the client that already has it gets a new token.

        Args:
            session: Identifies the client.
            holder: Name of the client, for messages.

        Returns:
            The token.

        Raises:
            LeaseRefused: Another client has it.
        """
        if self.token and session != self._session:
            left_s = self.ttl_s - self._timer.silence_s
            raise LeaseRefused(
                f"robot {self._name!r} is used by {self.holder}, until that client ends or is "
                f"silent for {max(0.0, left_s):.1f} s more; wait for it, or stop it"
            )
        self._last_token += 1
        self.token, self._session, self.holder, self.n = self._last_token, session, holder, 0
        self.renew()
        return self.token

    def require(self, token: int) -> None:
        """Check that a request comes from the client that has the lease, and renew the lease.

        Raises:
            LeaseRefused: The token is not that of the lease in force.
        """
        if not self.token or token != self.token:
            now = f"the robot is used by {self.holder}" if self.token else "it has ended"
            raise LeaseRefused(
                f"lease {token} of robot {self._name!r} is not in force: {now}; open it again"
            )
        self.renew()

    def renew(self) -> None:
        """Restart the time after which a silent client loses the lease."""
        self._timer.restart()

    def release(self) -> None:
        """End the lease."""
        self.token, self.holder, self._session, self.n = 0, "", "", 0

    def expire(self) -> bool:
        """End the lease of a client that was silent for too long.

        Returns:
            Whether it ended now.
        """
        if not self.token or not self._timer.expired:
            return False
        self.release()
        return True
