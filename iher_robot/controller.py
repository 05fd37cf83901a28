"""From an action of the policy to a command for the robot, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers import AppliedCommand, Command, EndEffectorCommand, RobotSpec, RobotState


class Controller(Protocol):
    """Turns actions into commands of one kind."""

    kind: ClassVar[str]
    """Kind of command that it makes."""

    @property
    def settings(self) -> Mapping[str, bool | int | float | str]:
        """What a policy file records of it."""
        ...

    def command(self, action: NDArray[np.floating], state: RobotState, spec: RobotSpec) -> Command:
        """Return the command for an action.

        Args:
            action: In [-1, 1]: dx, dy, dz, gripper. ``(4,)``
            state: What the command answers.
            spec: The robot.
        """
        ...

    def applied_action(self, applied: AppliedCommand, spec: RobotSpec) -> NDArray[np.float32]:
        """Return the action that what was applied amounts to, in [-1, 1]. ``(4,)``"""
        ...


class EndEffectorController:
    """Passes displacements through to robots that take them, as the Fetch environments do."""

    kind: ClassVar[str] = EndEffectorCommand.kind

    def __init__(self, blocks_gripper: bool) -> None:
        """Set the controller up.

        Args:
            blocks_gripper: Whether the task keeps the gripper as it is.
        """
        self._blocks_gripper = blocks_gripper

    @property
    def settings(self) -> Mapping[str, bool | int | float | str]:
        """What a policy file records of it."""
        return {"kind": self.kind, "blocks_gripper": self._blocks_gripper}

    def command(
        self, action: NDArray[np.floating], state: RobotState, spec: RobotSpec
    ) -> EndEffectorCommand:
        """Return the displacement for an action.

        Source: ``_set_action`` of `gymnasium_robotics/envs/fetch/fetch_env.py`.
        """
        # Scaled in the action's own precision, and widened afterwards, as the reference does.
        delta_pos = (action[:3] * spec.action.position_scale_m).astype(np.float64)
        gripper = 0.0 if self._blocks_gripper else float(action[3]) * spec.action.gripper_scale_m
        fingers = np.full(len(spec.finger_names), gripper)
        return EndEffectorCommand(state.seq, delta_pos, fingers)

    def applied_action(self, applied: AppliedCommand, spec: RobotSpec) -> NDArray[np.float32]:
        """Return the action that what was applied amounts to; a blocked gripper's part is 0."""
        assert isinstance(applied.command, EndEffectorCommand)
        delta_pos = applied.command.delta_pos / spec.action.position_scale_m
        gripper = float(np.mean(applied.command.finger_delta)) / spec.action.gripper_scale_m
        action = np.clip(np.append(delta_pos, gripper), -1.0, 1.0)
        return np.asarray(action, dtype=np.float32)
