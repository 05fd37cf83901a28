"""Commands and reset requests to a robot, and their results.

A command contains no time stamp: it names the state that it answers by sequence, and the robot's
side checks that state's age on its own clock.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.errors import InvalidCommand
from drivers.spec import RobotSpec


def frozen_array(value: ArrayLike) -> NDArray[np.float64]:
    """Copy into a read-only array of doubles."""
    array = np.array(value, dtype=np.float64)
    array.setflags(write=False)
    return array


def _check(name: str, value: NDArray[np.float64], shape: tuple[int, ...]) -> None:
    if value.shape != shape:
        raise InvalidCommand(f"{name} has shape {value.shape}, allowed: {shape}")
    if not np.isfinite(value).all():
        raise InvalidCommand(f"{name} is {value.tolist()}, allowed: finite numbers")


@dataclass(frozen=True, eq=False)
class Command(ABC):
    """A target for one control tick.

    Attributes:
        answers: Sequence of the state that it was computed from.
    """

    kind: ClassVar[str]
    answers: int

    @abstractmethod
    def check(self, spec: RobotSpec) -> None:
        """Check shapes and values; each kind extends it.

        Raises:
            InvalidCommand: If a shape is wrong, a value is not finite, or `answers` is not an int.
        """
        if type(self.answers) is not int:  # bool is a subclass of int
            raise InvalidCommand(
                f"answers is {self.answers!r}, allowed: the seq of a state, an int"
            )


@dataclass(frozen=True, eq=False)
class EndEffectorCommand(Command):
    """Displace the end effector and the fingers from their current positions.

    Attributes:
        delta_pos: Displacement in the action's frame, m. ``(3,)``
        finger_delta: Displacement of each finger, m. ``(n_fingers,)``
    """

    kind: ClassVar[str] = "ee_delta"
    delta_pos: NDArray[np.float64]
    finger_delta: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "delta_pos", frozen_array(self.delta_pos))
        object.__setattr__(self, "finger_delta", frozen_array(self.finger_delta))

    def check(self, spec: RobotSpec) -> None:
        """Raise `InvalidCommand` for wrong shapes and values that are not finite."""
        super().check(spec)
        _check("delta_pos", self.delta_pos, (3,))
        _check("finger_delta", self.finger_delta, (len(spec.finger_names),))


@dataclass(frozen=True, eq=False)
class JointCommand(Command):
    """Move the joints to a target, interpolated on the robot's side.

    Attributes:
        q_target: Target positions, rad or m. ``(n_joints,)``
        dq: Feed-forward velocities at the target. ``(n_joints,)``
        duration_s: Time in which to reach the target.
        finger_target: Finger positions, m. ``(n_fingers,)``
    """

    kind: ClassVar[str] = "joint"
    q_target: NDArray[np.float64]
    dq: NDArray[np.float64]
    duration_s: float
    finger_target: NDArray[np.float64]

    def __post_init__(self) -> None:
        for name in ("q_target", "dq", "finger_target"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))

    def check(self, spec: RobotSpec) -> None:
        """Raise `InvalidCommand` as above, and for a duration that is not positive."""
        super().check(spec)
        n_joints = (len(spec.joint_names),)
        _check("q_target", self.q_target, n_joints)
        _check("dq", self.dq, n_joints)
        _check("finger_target", self.finger_target, (len(spec.finger_names),))
        duration_s = self.duration_s
        is_number = type(duration_s) is not bool and isinstance(duration_s, int | float)
        if not is_number or not 0 < duration_s < float("inf"):
            raise InvalidCommand(f"duration_s is {duration_s!r}, allowed: above 0 and finite")


class Refusal(StrEnum):
    """Why a command was not accepted. A correct controller can get each of these."""

    DISARMED = "disarmed"
    LATCHED = "latched"
    EXPIRED = "expired"
    UNKNOWN_STATE = "unknown_state"
    BAD_MEASUREMENT = "bad_measurement"
    """The robot's state contains values that are not finite, so that no limit can be checked."""


@dataclass(frozen=True)
class Acceptance:
    """Whether a command was accepted. What was applied arrives in the next state.

    Attributes:
        refusal: Why it was refused, None if it was accepted.
        message: The reason with values, for people; empty if it was accepted.
    """

    refusal: Refusal | None = None
    message: str = ""

    @property
    def accepted(self) -> bool:
        """Whether the command was accepted."""
        return self.refusal is None


@dataclass(frozen=True)
class ResetRequest:
    """Where objects should be at the start of an episode. The robot itself goes home.

    Attributes:
        objects: Position of each object on the table, in the spec's frame, m.
        seed: Seed of a simulated robot's random numbers, such as noise; a real robot ignores it.
    """

    objects: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    seed: int = 0


class ResetOutcome(StrEnum):
    """How a reset ended."""

    DONE = "done"
    NEEDS_HUMAN = "needs_human"
    FAILED = "failed"


@dataclass(frozen=True)
class ResetResult:
    """How a reset ended, with a message that tells a person what to do."""

    outcome: ResetOutcome
    message: str = ""
