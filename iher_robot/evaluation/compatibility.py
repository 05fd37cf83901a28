"""Compatibility of a trained policy with a robot: interface, body and controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch

from drivers import RobotSpec
from drivers.canonical import Json, differences, digest
from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.errors import UserError
from iher_robot.evaluation.policy_file import PolicyFile, check_task, load_policy
from iher_robot.learning.goal_model import REAL
from iher_robot.learning.policy import Policy
from tasks import GoalTask, make_task

ACCEPT_INTERFACE = "--accept-interface"


@dataclass(frozen=True)
class TrainedPolicy:
    """A trained policy from its file, ready to act.

    Attributes:
        path: Its file.
        file: Content of the file: its interface and how it was trained.
        task: The task that it was trained for, not bound to a robot.
        policy: Its networks, on the CPU.
    """

    path: Path
    file: PolicyFile
    task: GoalTask
    policy: Policy


def load_trained_policy(path: Path, task: str | None = None) -> TrainedPolicy:
    """Read a policy and check that it acts.

    Args:
        path: The policy file.
        task: The task that it is expected to be for; any where None.

    Raises:
        UserError: The file is damaged, or is for another task, or its networks cannot act.
    """
    file = load_policy(path)
    asked = make_task(file.task if task is None else task)
    check_task(file, asked.name, asked.layout.digest())
    return TrainedPolicy(path, file, asked, _policy(file, path, asked))


def check_fit(
    trained: TrainedPolicy, env: GoalRobotEnv, *, accept_interface: bool = False
) -> tuple[str, ...]:
    """Refuse a robot with another interface; return what else differs.

    Args:
        trained: The policy.
        env: The robot, not yet moving.
        accept_interface: Accept another interface, unless the robot is physical.

    Returns:
        A sentence for each difference that is accepted.

    Raises:
        UserError: The interface differs and is not accepted, or the action has another length.
    """
    file, spec = trained.file, env.robot_spec
    found = interface_warnings(trained, env, accept_interface=accept_interface)
    if file.body_digest != spec.body_digest:
        changed_names = _changed(_saved_body(file), spec.body())
        found.append(f"the policy was trained on another body, it differs in {changed_names}")
    return (*found, *controller_warnings(trained, env))


def interface_warnings(
    trained: TrainedPolicy, env: GoalRobotEnv, *, accept_interface: bool = False
) -> list[str]:
    """Refuse a robot with another interface, or return what differs; see `check_fit`."""
    file, spec = trained.file, env.robot_spec
    found = []
    if file.interface_digest != spec.interface_digest:
        changed = _differences(file.spec, spec.to_dict(), spec.interface())
        if spec.physical or not accept_interface:
            advice = "train one on this robot"
            if not spec.physical:
                advice += f", or run it anyway with {ACCEPT_INTERFACE}"
            raise UserError(
                f"{spec.name} has another interface than the policy was trained for: "
                f"{'; '.join(changed)}; {advice}"
            )
        found += [
            f"{spec.name} has another interface than the policy was trained for: {difference}"
            for difference in changed
        ]
    if env.action_space.shape != (trained.policy.shapes.action_dim,):
        raise UserError(
            f"{trained.path} holds a policy of {trained.policy.shapes.action_dim} action values, "
            f"the robot takes {env.action_space.shape}; train it again"
        )
    return found


def controller_warnings(trained: TrainedPolicy, env: GoalRobotEnv) -> list[str]:
    """Return what differs in the settings of the controller; empty if nothing does."""
    saved, present = trained.file.controller, env.controller.settings
    if saved == dict(present):
        return []
    changed_names = _changed(saved, present)
    return [f"the policy was trained with another controller, it differs in {changed_names}"]


def body_differences(file: PolicyFile, spec: RobotSpec) -> list[str]:
    """Return what differs between a robot's body and the one that a policy was trained on.

    Args:
        file: The policy.
        spec: The robot.

    Returns:
        Sentences such as ``"gains.arm_kp: 30000.0, not 100000.0"``; empty if nothing differs.
    """
    if file.body_digest == spec.body_digest:
        return []
    return _differences(_saved_body(file), spec.body(), spec.body())


def _saved_body(file: PolicyFile) -> dict[str, Json]:
    """Return the body that a policy saved, in the form of `RobotSpec.body`."""
    limits = file.spec.get("limits")
    joints = limits.get("joints") if isinstance(limits, dict) else None
    model = file.spec.get("kinematic_model")
    return file.spec | {
        "joint_names": list(joints) if isinstance(joints, dict) else None,
        "kinematic_model": digest(model) if isinstance(model, str) else None,
    }


def _policy(file: PolicyFile, path: Path, task: GoalTask) -> Policy:
    """Build the networks of a policy file; its checksum does not say that they can act."""
    try:
        policy = Policy.from_snapshot(file.policy, device=torch.device("cpu"))
        observation = torch.zeros(1, task.layout.obs_dim)
        goal = torch.zeros(1, task.goal_dim)
        action = policy.act(observation, goal, torch.tensor([REAL]))
    except (
        ArithmeticError,
        AttributeError,
        KeyError,
        RuntimeError,
        TypeError,
        ValueError,
    ) as error:
        named = f"it has no {error}" if isinstance(error, KeyError) else str(error)
        reason = " ".join(named.split())
        raise UserError(f"{path} holds no policy that can act: {reason}; train it again") from error
    if not torch.isfinite(action).all():
        raise UserError(f"{path} holds no policy that can act: its actions are not finite")
    return policy


def _differences(
    saved: Mapping[str, Json], present: Mapping[str, Json], names: Mapping[str, object]
) -> list[str]:
    """Every leaf of the named parts in which the robot differs from what the policy saved."""
    mine, theirs = ({name: whole.get(name) for name in names} for whole in (present, saved))
    return differences(mine, theirs) or ["a setting that the policy does not name"]


def _changed(saved: Mapping[str, object], present: Mapping[str, object]) -> str:
    names = [name for name, value in present.items() if saved.get(name, value) != value]
    return ", ".join(names) or "a setting that the policy does not name"
