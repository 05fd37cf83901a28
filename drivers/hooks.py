"""The hooks that a robot driver implements."""

from __future__ import annotations

from abc import ABC, abstractmethod

from drivers.command import Command, ResetRequest, ResetResult
from drivers.state import RobotState


class RobotHooks(ABC):
    """Hooks that `RobotDriver` calls, one at a time, in the states that its contract allows."""

    @abstractmethod
    def _open(self) -> None:
        """Connect; leave the robot held. If it raises, `_hold` and `_close` are called."""

    @abstractmethod
    def _hold(self) -> None:
        """Drop any command not yet applied and come to zero motion, powered. Idempotent.

        Also called after an `_open` that failed half-way.
        """

    @abstractmethod
    def _read(self) -> RobotState:
        """Return the newest measurement, however old it is. Called often: cache it."""

    @abstractmethod
    def _apply(self, command: Command, clipped: tuple[str, ...]) -> None:
        """Set the command of this tick, replacing an earlier one.

        Args:
            command: Valid, fresh and within every limit.
            clipped: Why it differs from the requested one, for `AppliedCommand`.
        """

    @abstractmethod
    def _advance(self) -> None:
        """Step the physics, or wait for the robot's next tick; without a command, brake."""

    @abstractmethod
    def _reset(self, request: ResetRequest) -> ResetResult:
        """Reset the robot, at `speed_scale` of full speed."""

    @abstractmethod
    def _close(self) -> None:
        """Disconnect; leave the robot held. Also called after an `_open` that failed half-way."""

    def _interrupt(self) -> None:  # noqa: B027 - optional: many hooks never wait
        """Make a hook that waits in another thread return early. Called without the lock."""

    def _prepare_to_arm(self) -> None:  # noqa: B027 - optional: many robots are always ready
        """Make the robot ready for commands, before the gate opens; it stays held."""

    def _hands_confirmed(self) -> None:  # noqa: B027 - optional: few robots need it
        """Called when a person confirmed that hands are clear."""
