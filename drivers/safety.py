"""The safety filter: checks and limits every command before it reaches a robot's motors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import numpy as np

from drivers.clock import Clock
from drivers.command import Acceptance, Command, EndEffectorCommand, JointCommand, Refusal
from drivers.displacement import DisplacementLimit
from drivers.errors import InvalidCommand
from drivers.gate import CommandGate
from drivers.joint_motion import JointMotion
from drivers.spec import RobotSpec
from drivers.state import JointSetpoint, RobotState


class SafetyFilter:
    """Checks and limits commands on the robot's side.

    In this order: `check` raises for invalid kinds, shapes and values; `judge` refuses commands
    while disarmed or stopped, in answer to states that are unknown or too old, and while the
    robot's own measurement is not finite; `limit` cuts the others to speeds, accelerations,
    ranges, the workspace and the keep-out boxes. A tick without a command brakes (`brake`): that
    is the deadman.

    This is software. It is not a safety-rated stop and replaces none.

    Attributes:
        gate: The command gate, which is armed, disarmed and latched.
    """

    def __init__(self, spec: RobotSpec, clock: Clock) -> None:
        """Set the filter up for a robot.

        Args:
            spec: The robot.
            clock: The robot's clock.

        Raises:
            InvalidSpec: If the robot takes joint commands and its kinematic model cannot be used.
        """
        self.gate = CommandGate(spec, clock)
        self._spec = spec
        takes_joints = JointCommand.kind in spec.command_kinds
        self._joints = JointMotion(spec) if takes_joints else None
        self._displacement = DisplacementLimit(spec)
        self._clips: Counter[str] = Counter()

    @property
    def clips(self) -> Mapping[str, int]:
        """How many commands were cut, by reason."""
        return dict(self._clips)

    def check(self, command: Command) -> None:
        """Check the kind, shapes and values of a command.

        Raises:
            InvalidCommand: If one of them is wrong.
        """
        if command.kind not in self._spec.command_kinds:
            raise InvalidCommand(
                f"{self._spec.name} takes no {command.kind!r} command, "
                f"allowed: {', '.join(self._spec.command_kinds)}"
            )
        command.check(self._spec)

    def judge(self, command: Command, state: RobotState) -> Acceptance:
        """Accept or refuse a command; refusals are counted.

        Args:
            command: A checked command.
            state: The robot's newest state.
        """
        judgement = self.gate.judge(command)
        if judgement.accepted and not _is_finite(state):
            return self.gate.refuse(
                Refusal.BAD_MEASUREMENT,
                f"state {state.seq} of {self._spec.name} has values that are not finite",
            )
        return judgement

    def limit(
        self, command: Command, state: RobotState, speed_scale: float
    ) -> tuple[Command, tuple[str, ...]]:
        """Limit the motion of the next tick, and count the reasons of cuts.

        Args:
            command: A command that was accepted.
            state: The robot's newest state; a joint motion starts from its `setpoint`.
            speed_scale: Share of full speed that is allowed, in (0, 1].

        Returns:
            The command to apply, and why it differs from the requested one.
        """
        limited: Command
        if isinstance(command, JointCommand):
            assert self._joints is not None
            assert state.setpoint is not None, "a robot that takes joint commands has a setpoint"
            limited, reasons = self._joints.limit(command, state.setpoint, speed_scale)
        elif isinstance(command, EndEffectorCommand):
            limited, reasons = self._displacement.limit(command, state.ee_pos, speed_scale)
        else:
            raise InvalidCommand(
                f"kind of command is {command.kind!r}, which SafetyFilter cannot limit; override "
                "SafetyFilter.limit for it"
            )
        self._clips.update(reasons)
        return limited, reasons

    def brake(self, setpoint: JointSetpoint) -> JointSetpoint:
        """Return the setpoint at the end of a tick of braking.

        Args:
            setpoint: The current one.
        """
        assert self._joints is not None, "only a robot that takes joint commands has a setpoint"
        return self._joints.brake(setpoint)


def _is_finite(state: RobotState) -> bool:
    arrays = [state.q, state.dq, state.ee_pos, state.fingers_pos]
    if state.setpoint is not None:
        arrays += [state.setpoint.q, state.setpoint.dq, state.setpoint.fingers]
    return bool(np.isfinite(np.concatenate(arrays)).all())
