"""Everything that stands between a sender of commands and the motors of a robot."""

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
    """Decides on the robot's side what of a command reaches the motors.

    In this order: `check` refuses shapes, kinds and values that make no sense; `gate` refuses
    while disarmed or stopped, answers to states that are unknown or too old, and everything
    while the robot's own measurement is not finite (`judge`); `limit` cuts
    what is left to speeds, accelerations, ranges, the workspace and what is kept out of. A
    tick without a command is a tick of braking (`brake`): that is the deadman.

    This is software. It is not a safety-rated stop and replaces none.

    Attributes:
        gate: Open only while armed, and never with a fault.
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
        """Refuse a command that this robot can never carry out.

        Raises:
            InvalidCommand: If its kind, a shape or a value is wrong.
        """
        if command.kind not in self._spec.command_kinds:
            raise InvalidCommand(
                f"{self._spec.name} takes no {command.kind!r} command, "
                f"allowed: {', '.join(self._spec.command_kinds)}"
            )
        command.check(self._spec)

    def judge(self, command: Command, state: RobotState) -> Acceptance:
        """Say whether a command may pass now, and count it if not.

        Args:
            command: What was asked, checked.
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
        """Cut a command to what the limits allow in the next tick, and count why.

        Args:
            command: What was asked, checked and judged.
            state: The robot's newest state, whose `setpoint` a joint motion starts from.
            speed_scale: Share of full speed that is allowed, in (0, 1].

        Returns:
            What to apply, and why it differs from what was asked.
        """
        limited: Command
        if isinstance(command, JointCommand):
            assert self._joints is not None
            assert state.setpoint is not None, "a robot that takes joint commands has a setpoint"
            limited, reasons = self._joints.limit(command, state.setpoint, speed_scale)
        elif isinstance(command, EndEffectorCommand):
            limited, reasons = self._displacement.limit(command, state.ee_pos, speed_scale)
        else:
            raise InvalidCommand(f"no limits are known for {command.kind!r} commands; add them")
        self._clips.update(reasons)
        return limited, reasons

    def brake(self, setpoint: JointSetpoint) -> JointSetpoint:
        """Return where a tick without a command takes the joints: towards rest.

        Args:
            setpoint: What the motors follow now.
        """
        assert self._joints is not None, "only a robot that takes joint commands has a setpoint"
        return self._joints.brake(setpoint)


def _is_finite(state: RobotState) -> bool:
    arrays = [state.q, state.dq, state.ee_pos, state.fingers_pos]
    if state.setpoint is not None:
        arrays += [state.setpoint.q, state.setpoint.dq, state.setpoint.fingers]
    return bool(np.isfinite(np.concatenate(arrays)).all())
