"""Controllers: convert a policy's action to a robot command, and an applied command back."""

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
    """Converts actions to commands of one kind, for one robot."""

    kind: ClassVar[str]
    """Kind of its commands."""

    @property
    def settings(self) -> Mapping[str, bool | int | float | str]:
        """Settings that a policy file records."""
        ...

    def command(self, action: NDArray[np.floating], state: RobotState) -> Command:
        """Return the command for an action.

        Args:
            action: In [-1, 1]: dx, dy, dz, gripper. ``(4,)``
            state: State that the command answers.

        Raises:
            NoSolution: If there is no command; the robot holds for this tick.
        """
        ...

    def applied_action(
        self, requested: NDArray[np.float32], applied: AppliedCommand, before: RobotState
    ) -> NDArray[np.float32]:
        """Return the action equivalent to an applied command, in [-1, 1].

        Args:
            requested: The action of the command; returned unchanged where the command was
                applied unchanged. ``(4,)``
            applied: The command that the robot reports as applied in a tick.
            before: The state at the start of that tick.

        Returns:
            ``(4,)``
        """
        ...


class EndEffectorController:
    """Passes displacements on to robots that accept them, as the Fetch environments do."""

    kind: ClassVar[str] = EndEffectorCommand.kind

    def __init__(self, spec: RobotSpec, blocks_gripper: bool) -> None:
        """Create the controller.

        Args:
            spec: The robot.
            blocks_gripper: Whether the task fixes the gripper.
        """
        self._spec = spec
        self._blocks_gripper = blocks_gripper

    @property
    def settings(self) -> Mapping[str, bool | int | float | str]:
        """Settings that a policy file records."""
        return {"kind": self.kind, "blocks_gripper": self._blocks_gripper}

    def command(self, action: NDArray[np.floating], state: RobotState) -> EndEffectorCommand:
        """Return the displacement for an action.

        Source: ``_set_action`` of `gymnasium_robotics/envs/fetch/fetch_env.py`.
        """
        scales = self._spec.action
        # Scaled in the action's precision, then widened, as the reference does.
        delta_pos = (action[:3] * scales.position_scale_m).astype(np.float64)
        gripper = 0.0 if self._blocks_gripper else float(action[3]) * scales.gripper_scale_m
        fingers = np.full(len(self._spec.finger_names), gripper)
        return EndEffectorCommand(state.seq, delta_pos, fingers)

    def applied_action(
        self,
        requested: NDArray[np.float32],
        applied: AppliedCommand,
        before: RobotState,  # noqa: ARG002 - a displacement needs no state
    ) -> NDArray[np.float32]:
        """Return the action equivalent to an applied command; 0 for a blocked gripper."""
        if not applied.clipped:
            return requested  # a conversion to metres and back would change the last bits
        assert isinstance(applied.command, EndEffectorCommand)
        scales = self._spec.action
        delta_pos = applied.command.delta_pos / scales.position_scale_m
        gripper = float(np.mean(applied.command.finger_delta)) / scales.gripper_scale_m
        action = np.clip(np.append(delta_pos, gripper), -1.0, 1.0)
        return np.asarray(action, dtype=np.float32)


def make_controller(spec: RobotSpec, blocks_gripper: bool) -> Controller:
    """Return the controller for the commands that a robot accepts.

    Args:
        spec: The robot; displacements are passed on where it accepts them.
        blocks_gripper: Whether the task fixes the gripper.

    Raises:
        UserError: If it accepts no command of a controller.
    """
    if EndEffectorCommand.kind in spec.command_kinds:
        return EndEffectorController(spec, blocks_gripper)
    if JointCommand.kind in spec.command_kinds:
        from iher_robot.env.ik_controller import JointController  # loads MuJoCo

        return JointController(spec, blocks_gripper)
    raise UserError(
        f"{spec.name} accepts {', '.join(spec.command_kinds)} commands, controllers make: "
        f"{EndEffectorCommand.kind}, {JointCommand.kind}"
    )
