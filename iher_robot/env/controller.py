"""From an action of the policy to a command for the robot, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers import (
    AppliedCommand,
    Command,
    EndEffectorCommand,
    JointCommand,
    RobotSpec,
    RobotState,
)
from iher_robot.errors import UserError


class Controller(Protocol):
    """Turns actions into commands of one kind, for one robot."""

    kind: ClassVar[str]
    """Kind of command that it makes."""

    @property
    def settings(self) -> Mapping[str, bool | int | float | str]:
        """What a policy file records of it."""
        ...

    def command(self, action: NDArray[np.floating], state: RobotState) -> Command:
        """Return the command for an action.

        Args:
            action: In [-1, 1]: dx, dy, dz, gripper. ``(4,)``
            state: What the command answers.

        Raises:
            NoSolution: If there is none; the robot holds for this tick.
        """
        ...

    def applied_action(
        self, requested: NDArray[np.float32], applied: AppliedCommand, before: RobotState
    ) -> NDArray[np.float32]:
        """Return the action that what was applied amounts to, in [-1, 1].

        Args:
            requested: The action that the command was made from; returned as it is where the
                command was carried out as asked. ``(4,)``
            applied: What the robot says it did in a tick.
            before: The state at the start of that tick.

        Returns:
            ``(4,)``
        """
        ...


class EndEffectorController:
    """Passes displacements through to robots that take them, as the Fetch environments do."""

    kind: ClassVar[str] = EndEffectorCommand.kind

    def __init__(self, spec: RobotSpec, blocks_gripper: bool) -> None:
        """Set the controller up.

        Args:
            spec: The robot.
            blocks_gripper: Whether the task keeps the gripper as it is.
        """
        self._spec = spec
        self._blocks_gripper = blocks_gripper

    @property
    def settings(self) -> Mapping[str, bool | int | float | str]:
        """What a policy file records of it."""
        return {"kind": self.kind, "blocks_gripper": self._blocks_gripper}

    def command(self, action: NDArray[np.floating], state: RobotState) -> EndEffectorCommand:
        """Return the displacement for an action.

        Source: ``_set_action`` of `gymnasium_robotics/envs/fetch/fetch_env.py`.
        """
        scales = self._spec.action
        # Scaled in the action's own precision, and widened afterwards, as the reference does.
        delta_pos = (action[:3] * scales.position_scale_m).astype(np.float64)
        gripper = 0.0 if self._blocks_gripper else float(action[3]) * scales.gripper_scale_m
        fingers = np.full(len(self._spec.finger_names), gripper)
        return EndEffectorCommand(state.seq, delta_pos, fingers)

    def applied_action(
        self,
        requested: NDArray[np.float32],
        applied: AppliedCommand,
        before: RobotState,  # noqa: ARG002 - a displacement says it all
    ) -> NDArray[np.float32]:
        """Return the action that what was applied amounts to; a blocked gripper's part is 0."""
        if not applied.clipped:
            return requested  # a round trip through metres would cost its last bits
        assert isinstance(applied.command, EndEffectorCommand)
        scales = self._spec.action
        delta_pos = applied.command.delta_pos / scales.position_scale_m
        gripper = float(np.mean(applied.command.finger_delta)) / scales.gripper_scale_m
        action = np.clip(np.append(delta_pos, gripper), -1.0, 1.0)
        return np.asarray(action, dtype=np.float32)


def make_controller(spec: RobotSpec, blocks_gripper: bool) -> Controller:
    """Return the controller for the commands that a robot takes.

    Args:
        spec: The robot; displacements are passed through where it takes them.
        blocks_gripper: Whether the task keeps the gripper as it is.

    Raises:
        UserError: If it takes no command that a controller makes.
    """
    if EndEffectorCommand.kind in spec.command_kinds:
        return EndEffectorController(spec, blocks_gripper)
    if JointCommand.kind in spec.command_kinds:
        from iher_robot.env.ik_controller import JointController  # it loads MuJoCo

        return JointController(spec, blocks_gripper)
    raise UserError(
        f"{spec.name} takes {', '.join(spec.command_kinds)} commands, controllers make: "
        f"{EndEffectorCommand.kind}, {JointCommand.kind}"
    )
