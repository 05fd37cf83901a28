"""The policy file of a training run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from iher_robot.config.run import RunConfig
from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.evaluation.policy_file import PolicyFile
from iher_robot.learning.policy import Policy


def trained_policy(
    policy: Policy,
    env: GoalRobotEnv,
    config: RunConfig,
    provenance: Mapping[str, Any],
    row: Mapping[str, float],
) -> PolicyFile:
    """Put a policy together with what it fits and how it came about.

    Args:
        policy: The policy.
        env: The environment it was trained in.
        config: Settings of the run.
        provenance: Where the run comes from.
        row: Metrics of the last epoch.

    Returns:
        What to save.
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
