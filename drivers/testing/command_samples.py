"""Valid, excessive and invalid commands of each kind, for the tests of a driver."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from drivers import Command, EndEffectorCommand, JointCommand, RobotSpec, RobotState

_BAD_NUMBERS = (np.nan, np.inf, -np.inf)
_BAD_ANSWERS = (1.0, True, None, [1])


class CommandSamples(ABC):
    """Makes commands of one kind for one robot."""

    kind: ClassVar[str]

    def __init__(self, spec: RobotSpec) -> None:
        """Store the robot's description.

        Args:
            spec: The robot.
        """
        self.spec = spec

    @abstractmethod
    def small(self, state: RobotState, sign: float = 1.0) -> Command:
        """Return a small motion that exceeds no limit.

        Args:
            state: The state to answer, at most a few ticks of small commands away from home.
            sign: 1 for one direction, -1 for the opposite one.
        """

    @abstractmethod
    def excessive(self, state: RobotState, rng: np.random.Generator, sign: float = 1.0) -> Command:
        """Return a motion in a random direction, 100 times larger than every limit.

        Args:
            state: The state to answer.
            rng: Draws the direction.
            sign: 1 for this direction, -1 for the opposite one.
        """

    @abstractmethod
    def asked(self, state: RobotState, command: Command) -> float:
        """Return the displacement that a small command requests from a state, m or rad."""

    @abstractmethod
    def moved(self, before: RobotState, after: RobotState) -> float:
        """Return the displacement of the robot in the direction of small commands, m or rad."""

    def broken(self, state: RobotState) -> Iterator[tuple[str, Command]]:
        """Yield invalid commands, each with a description of what is wrong.

        Args:
            state: The state to answer.
        """
        good = self.small(state)
        for field in dataclasses.fields(good):
            value = getattr(good, field.name)
            for bad in _broken_values(field.name, value):
                changes: dict[str, Any] = {field.name: bad}
                yield f"{field.name} = {bad}", dataclasses.replace(good, **changes)


def _broken_values(name: str, value: object) -> Iterator[object]:
    if name == "answers":
        yield from _BAD_ANSWERS
    elif isinstance(value, np.ndarray):
        yield np.append(value, 0.0)
        yield value[None]
        for number in _BAD_NUMBERS:
            bad = value.copy()
            bad[-1:] = number
            if bad.size:
                yield bad
    elif isinstance(value, float):
        yield from (*_BAD_NUMBERS, 0.0, -1.0)


class EndEffectorSamples(CommandSamples):
    """Displacements of the end effector along x."""

    kind = EndEffectorCommand.kind
    share = 0.2
    """Share of the displacement of an action of 1, and of the speed limit."""

    def small(self, state: RobotState, sign: float = 1.0) -> EndEffectorCommand:
        """Return a displacement along x."""
        fastest = self.spec.limits.max_ee_speed_m_s * self.spec.control_period_s
        step = sign * self.share * min(self.spec.action.position_scale_m, fastest)
        return EndEffectorCommand(state.seq, np.array([step, 0.0, 0.0]), self._fingers(0.0))

    def excessive(
        self, state: RobotState, rng: np.random.Generator, sign: float = 1.0
    ) -> EndEffectorCommand:
        """Return a displacement of 100 times the scale of an action."""
        direction = rng.normal(size=3)
        direction *= sign * 100.0 * self.spec.action.position_scale_m / np.linalg.norm(direction)
        fingers = self._fingers(rng.choice((-100.0, 100.0)) * self.spec.action.gripper_scale_m)
        return EndEffectorCommand(state.seq, direction, fingers)

    def asked(self, state: RobotState, command: Command) -> float:  # noqa: ARG002
        """Return the displacement along x, m."""
        assert isinstance(command, EndEffectorCommand)
        return float(command.delta_pos[0])

    def moved(self, before: RobotState, after: RobotState) -> float:
        """Return the displacement along x, m."""
        return float(after.ee_pos[0] - before.ee_pos[0])

    def _fingers(self, displacement: float) -> NDArray[np.float64]:
        return np.full(len(self.spec.finger_names), displacement)


class JointSamples(CommandSamples):
    """Motions of the first joint, towards the middle of its range, from the setpoint."""

    kind = JointCommand.kind
    speed_share = 0.2
    """Share of the joint's velocity limit."""
    acceleration_share = 0.5
    """Share of the joint's acceleration limit."""

    def small(self, state: RobotState, sign: float = 1.0, joint: int = 0) -> JointCommand:
        """Return one tick of a slow motion of one joint."""
        setpoint = state.setpoint
        limits = list(self.spec.limits.joints.values())[joint]
        assert setpoint is not None, "a robot that takes joint commands reports its setpoint"
        period_s = self.spec.control_period_s
        # Up, except from the top quarter of the range: no small motion gets from there to its end.
        high = setpoint.q[joint] > limits.lower + 0.75 * (limits.upper - limits.lower)
        goal = (-sign if high else sign) * self.speed_share * limits.max_velocity
        change = self.acceleration_share * limits.max_acceleration * period_s
        dq = np.zeros_like(setpoint.dq)
        dq[joint] = setpoint.dq[joint] + np.clip(goal - setpoint.dq[joint], -change, change)
        q_target = setpoint.q + (setpoint.dq + dq) / 2.0 * period_s
        return JointCommand(state.seq, q_target, dq, period_s, setpoint.fingers.copy())

    def still(self, state: RobotState) -> JointCommand:
        """Return a command to stay at the setpoint."""
        setpoint = state.setpoint
        assert setpoint is not None, "a robot that takes joint commands reports its setpoint"
        still = np.zeros_like(setpoint.dq)
        return JointCommand(
            state.seq, setpoint.q, still, self.spec.control_period_s, setpoint.fingers
        )

    def excessive(
        self, state: RobotState, rng: np.random.Generator, sign: float = 1.0
    ) -> JointCommand:
        """Return targets and velocities of 100 times the joints' limits."""
        setpoint = state.setpoint
        assert setpoint is not None, "a robot that takes joint commands reports its setpoint"
        fastest = np.array([joint.max_velocity for joint in self.spec.limits.joints.values()])
        fastest[~np.isfinite(fastest)] = 1.0
        dq = sign * rng.choice((-100.0, 100.0), size=fastest.shape) * fastest
        period_s = self.spec.control_period_s
        gripper = self.spec.limits.gripper
        reach = 100.0 * (gripper.upper_m - gripper.lower_m)
        fingers = np.full(len(self.spec.finger_names), rng.choice((-reach, reach)))
        return JointCommand(state.seq, setpoint.q + dq * period_s, dq, period_s, fingers)

    def asked(self, state: RobotState, command: Command) -> float:
        """Return the displacement of the first joint, rad or m."""
        assert isinstance(command, JointCommand)
        assert state.setpoint is not None
        return float(command.q_target[0] - state.setpoint.q[0])

    def moved(self, before: RobotState, after: RobotState) -> float:
        """Return the displacement of the first joint, rad or m, with the sign of `asked`."""
        return float(after.q[0] - before.q[0])
