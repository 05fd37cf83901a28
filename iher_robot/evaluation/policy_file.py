"""Policy file: networks, interface of the robot, and how they were trained."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from iher_robot.config.run import RunConfig
from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.errors import UserError
from iher_robot.learning.policy import Policy
from iher_robot.storage.files.torch_file import load_torch_file, save_torch_file

KIND = "policy"
VERSION = 2


@dataclass(frozen=True)
class PolicyFile:
    """A trained policy; all values plain: dicts, lists, text, numbers, tensors.

    Attributes:
        task: Name of the task.
        layout: Entries of the observation.
        layout_digest: Digest of the layout.
        spec: The robot it was trained on.
        interface_digest: Must match the robot's.
        body_digest: Differences to the robot's are listed.
        controller: Settings of the controller.
        policy: Networks, normalisers and their configuration, as the learner takes its snapshot.
        trained: How it was trained: algorithm, preset, driver, robot, seed, robot minutes,
            versions, commit, final success.
    """

    task: str
    layout: dict[str, Any]
    layout_digest: str
    spec: dict[str, Any]
    interface_digest: str
    body_digest: str
    controller: dict[str, Any]
    policy: dict[str, Any]
    trained: dict[str, Any]


_TYPES = {
    field.name: dict if "dict" in str(field.type) else str
    for field in dataclasses.fields(PolicyFile)
}


def save_policy(path: Path, policy: PolicyFile) -> None:
    """Write a policy file atomically.

    The file is what ``torch.save`` writes, for ``torch.load(path, weights_only=True)``, with a
    digest of its bytes in the archive's comment.

    Raises:
        ValueError: A value is not plain, or a tensor is not finite.
        UserError: The system refuses.
    """
    content = {name: _plain(getattr(policy, name), name) for name in _TYPES}
    for place, tensor in _tensors(content, ""):
        if not torch.isfinite(tensor).all():
            raise ValueError(f"policy value {place} is not finite")
    save_torch_file(path, content, kind=KIND, version=VERSION)


def load_policy(path: Path) -> PolicyFile:
    """Read a policy; nothing in the file is executed.

    Raises:
        UserError: The file is missing, truncated, damaged, foreign, of a newer version, or
            incomplete, or holds tensors that are not finite.
    """
    content = load_torch_file(path, kind=KIND, version=VERSION)
    return _from_content(content, path)


def check_task(policy: PolicyFile, task_name: str, layout_digest: str) -> None:
    """Check that a policy was trained for a task and its observations.

    Args:
        policy: The policy.
        task_name: The task to be run.
        layout_digest: Digest of that task's observation layout.

    Raises:
        UserError: It is for another task, or sees other observations.
    """
    if policy.task != task_name:
        raise UserError(
            f"the policy is for task {policy.task!r}, not {task_name!r}; run it on its own task, "
            "or train one for this"
        )
    if policy.layout_digest != layout_digest:
        raise UserError(
            f"the policy for task {task_name!r} was trained on another observation layout "
            f"({policy.layout_digest[:12]}, the task's is {layout_digest[:12]}); train it again"
        )


def _from_content(content: dict[str, Any], path: Path) -> PolicyFile:
    missing = [name for name in _TYPES if name not in content]
    if missing:
        raise UserError(f"{path} is incomplete: it has no {', '.join(missing)}")
    for name, kind in _TYPES.items():
        if type(content[name]) is not kind:
            found = type(content[name]).__name__
            raise UserError(f"{path} is damaged: {name} is {found}, expected {kind.__name__}")
    for place, tensor in _tensors(content, ""):
        if not torch.isfinite(tensor).all():
            raise UserError(f"{path} cannot be used: {place} is not finite; train it again")
    return PolicyFile(**{name: content[name] for name in _TYPES})


def _plain(value: Any, place: str) -> Any:
    """Copy values that ``weights_only`` can read, and refuse others before they are saved."""
    if isinstance(value, torch.Tensor):
        # A view would drag its whole storage into the file.
        return value.detach().cpu().clone()
    if isinstance(value, dict):
        if not all(isinstance(name, str) for name in value):
            raise ValueError(f"policy value {place} has keys that are not text")
        return {name: _plain(part, f"{place}.{name}") for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part, f"{place}[{index}]") for index, part in enumerate(value)]
    if value is None or type(value) in (str, int, float, bool):
        return value
    raise ValueError(f"policy value {place} is {type(value).__name__}, expected a plain value")


def _tensors(value: Any, place: str) -> Iterator[tuple[str, torch.Tensor]]:
    """Every tensor, and every number as a tensor, with its place."""
    if isinstance(value, torch.Tensor):
        yield place, value
    elif isinstance(value, float):
        if not math.isfinite(value):
            yield place, torch.tensor(value)
    elif isinstance(value, dict):
        for name, part in value.items():
            yield from _tensors(part, f"{place}.{name}" if place else str(name))
    elif isinstance(value, list | tuple):
        for index, part in enumerate(value):
            yield from _tensors(part, f"{place}[{index}]")


def make_policy_file(
    policy: Policy,
    env: GoalRobotEnv,
    config: RunConfig,
    provenance: Mapping[str, Any],
    row: Mapping[str, float],
) -> PolicyFile:
    """Make the content of a policy file.

    Args:
        policy: The policy.
        env: The environment that it was trained in.
        config: Settings of the run.
        provenance: Command, commit and versions of the run.
        row: Metrics of the last epoch.

    Returns:
        The content, for ``save_policy``.
    """
    trained: dict[str, Any] = {
        "algo": config.algo,
        "preset": config.preset,
        "driver": config.driver,
        "robot": config.robot,
        "robot_options": config.robot_options,
        "seed": config.seed,
        "robot_minutes": row["robot_minutes"],
        "epochs": int(row["epoch"]),
        "updates": int(row["updates"]),
        "success": row.get("success"),
        "versions": dict(provenance["versions"]),
        "commit": provenance["commit"],
        "dirty": provenance["dirty"],
    }
    return PolicyFile(policy=policy.snapshot(), trained=trained, **env.policy_interface())
