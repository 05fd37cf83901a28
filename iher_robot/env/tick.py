"""Control tick: the applied action, its validity for learning, and its cost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import Acceptance, Refusal, RobotState
from iher_robot.env.controller import Controller

CONTROLLER = "controller"
"""Reported in ``clipped`` where kinematics or the workspace made the controller request less."""

NO_SOLUTION = "no_solution"
"""Reported as refusal where the controller found no command."""


@dataclass(frozen=True, eq=False)
class Tick:  # noqa: PLW1641 - compared, never hashed
    """One control tick.

    Attributes:
        seq: The robot's own tick counter at its end.
        action_applied: The applied action, in [-1, 1]; zeros if none was. ``(action_dim,)``
        valid: Whether it may be used for learning: the command answered the previous state, was
            applied in this tick, and no tick is missing in between.
        elapsed: Ticks of the robot since the previous state, at least 1; charged to the budget.
        clipped: Why the robot clipped the command, or ``"controller"`` where the controller
            could not request the full action.
        late: Whether it shows a slow link: ticks were missed, the command expired, or it was
            accepted but not applied in time.
        acceptance: The robot's answer to the command, None without a command.
    """

    seq: int
    action_applied: NDArray[np.float32]
    valid: bool
    elapsed: int
    clipped: tuple[str, ...]
    late: bool
    acceptance: Acceptance | None

    def __eq__(self, other: object) -> bool:
        """Whether both had the same outcome; the counter, which outlives resets, may differ."""
        if not isinstance(other, Tick):
            return NotImplemented
        return np.array_equal(self.action_applied, other.action_applied) and all(
            getattr(self, name) == getattr(other, name)
            for name in ("valid", "elapsed", "clipped", "late", "acceptance")
        )

    @property
    def refusal(self) -> str | None:
        """Why the command was refused, ``"no_solution"`` without a command, or None."""
        return NO_SOLUTION if self.acceptance is None else self.acceptance.refusal

    def info(self) -> dict[str, object]:
        """Entries of the environment's ``info``: the tick, and its parts by name."""
        return {
            "tick": self,
            "action_applied": self.action_applied,
            "tick_valid": self.valid,
            "ticks": self.elapsed,
            "clipped": self.clipped,
            "refusal": self.refusal,
        }


def evaluate_tick(
    requested: NDArray[np.floating],
    before: RobotState,
    after: RobotState,
    acceptance: Acceptance | None,
    controller: Controller,
) -> Tick:
    """Compare the requested action with the command that the robot applied.

    Args:
        requested: The action, in [-1, 1]. ``(action_dim,)``
        before: The state that the command answered.
        after: The state at the end of the tick; `before` if none arrived.
        acceptance: The robot's answer to the command, None without a command.
        controller: Controller that made the command.
    """
    elapsed = after.seq - before.seq
    applied = after.applied
    action = np.asarray(requested, dtype=np.float32)
    if applied is None or applied.tick != after.seq or elapsed < 1:
        late = elapsed > 1 or _came_late(acceptance)
        return Tick(after.seq, np.zeros_like(action), False, max(1, elapsed), (), late, acceptance)
    request, action = action, controller.applied_action(action, applied, before)
    clipped = applied.clipped
    if not clipped and (action != request).any():
        clipped = (CONTROLLER,)
    valid = elapsed == 1 and applied.command.answers == before.seq
    late = elapsed > 1 or (not valid and _came_late(acceptance))
    return Tick(after.seq, action, valid, elapsed, clipped, late, acceptance)


def _came_late(acceptance: Acceptance | None) -> bool:
    """Whether a command that was not applied was late, rather than refused."""
    if acceptance is None:
        return False
    return acceptance.accepted or acceptance.refusal is Refusal.EXPIRED


class InvalidTicks:
    """Counts the invalid ticks of an episode.

    Args:
        allowed: Number that an episode may have.

    Attributes:
        count: Number of invalid ticks.
        late: Number of ticks that show a slow link.
    """

    def __init__(self, allowed: int) -> None:
        self.allowed = allowed
        self.count = 0
        self.late = 0

    def add(self, tick: Tick) -> None:
        """Count a tick."""
        self.count += not tick.valid
        self.late += tick.late

    @property
    def too_many(self) -> bool:
        """Whether there are more than are allowed."""
        return self.count > self.allowed

    @property
    def mostly_late(self) -> bool:
        """Whether most of them show a slow link."""
        return 2 * self.late > self.count
