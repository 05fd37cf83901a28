"""What an implementation of a robot driver writes."""

from __future__ import annotations

from abc import ABC, abstractmethod

from drivers.command import Command, ResetRequest, ResetResult
from drivers.state import RobotState


class RobotHooks(ABC):
    """Hooks that `RobotDriver` calls, one at a time, where its contract allows."""

    @abstractmethod
    def _open(self) -> None:
        """Connect; leave the robot held. If it raises, `_hold` and `_close` are called."""

    @abstractmethod
    def _hold(self) -> None:
        """Drop any command not yet applied and come to zero motion, powered. Idempotent.

        Also called after an `_open` that failed half-way, and must bear it.
        """

    @abstractmethod
    def _read(self) -> RobotState:
        """Return the newest measurement, however old it is. Called often: keep it."""

    @abstractmethod
    def _apply(self, command: Command, clipped: tuple[str, ...]) -> None:
        """Take the command of this tick, replacing an earlier one.

        Args:
            command: Valid, fresh and within every limit.
            clipped: Why it differs from what was asked, for `AppliedCommand`.
        """

    @abstractmethod
    def _advance(self) -> None:
        """Step the physics, or wait for the robot's next tick; without a command, brake."""

    @abstractmethod
    def _reset(self, request: ResetRequest) -> ResetResult:
        """Carry out a reset, at `speed_scale` of full speed."""

    @abstractmethod
    def _close(self) -> None:
        """Disconnect; leave the robot held. Also called after an `_open` that failed half-way."""

    def _interrupt(self) -> None:  # noqa: B027 - optional: many hooks never wait
        """Make a hook that waits in another thread return early. Called without a lock."""

    def _prepare_to_arm(self) -> None:  # noqa: B027 - optional: many robots are always ready
        """Make the robot ready for commands, before the gate opens; it stays held."""

    def _hands_confirmed(self) -> None:  # noqa: B027 - optional: few robots ask
        """Take note that a person confirmed that hands are clear."""
