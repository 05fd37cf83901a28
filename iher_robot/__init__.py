"""Learn manipulation from minutes of robot time, on a simulated robot or a real one.

``iher_robot.train(task="push", budget_minutes=10)`` is what ``iher-robot train`` does. Importing
the package registers its Gymnasium environments, such as ``iher_robot/Push-v0``, at once or as soon
as Gymnasium is imported; numpy, torch and the simulator are loaded when a name is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from iher_robot._shadowing import require_own_packages
from iher_robot.version import __version__

require_own_packages("drivers", "tasks")

from iher_robot.env.registration import register_envs, register_envs_with_gymnasium  # noqa: E402
from iher_robot.errors import UserError  # noqa: E402

if TYPE_CHECKING:
    from drivers import (
        ActionSpec,
        AppliedCommand,
        Box,
        Command,
        DriverError,
        EndEffectorCommand,
        GripperLimits,
        Home,
        InvalidRequest,
        InvalidSpec,
        JointCommand,
        JointLimits,
        JointSetpoint,
        Kinematics,
        Limits,
        Mode,
        MonotonicClock,
        ObjectPose,
        ObjectSource,
        ResetOutcome,
        ResetRequest,
        ResetResult,
        RobotDriver,
        RobotSpec,
        RobotState,
        SimulatedClock,
        make_driver,
    )
    from iher_robot.config.options import load_config
    from iher_robot.config.run import RunConfig, read_config
    from iher_robot.deployment.deploy import DeployResult, deploy
    from iher_robot.env.goal_env import GoalRobotEnv, make_env
    from iher_robot.evaluation.evaluate import EvaluationResult, evaluate
    from iher_robot.experiments.experiment import ExperimentResult, experiment
    from iher_robot.experiments.report.report import ReportResult, report
    from iher_robot.training.result import TrainResult
    from iher_robot.training.train import resume, train
    from tasks import TASKS, GoalModel, GoalTask, TaskError, make_task

__all__ = [
    "TASKS",
    "ActionSpec",
    "AppliedCommand",
    "Box",
    "Command",
    "DeployResult",
    "DriverError",
    "EndEffectorCommand",
    "EvaluationResult",
    "ExperimentResult",
    "GoalModel",
    "GoalRobotEnv",
    "GoalTask",
    "GripperLimits",
    "Home",
    "InvalidRequest",
    "InvalidSpec",
    "JointCommand",
    "JointLimits",
    "JointSetpoint",
    "Kinematics",
    "Limits",
    "Mode",
    "MonotonicClock",
    "ObjectPose",
    "ObjectSource",
    "ReportResult",
    "ResetOutcome",
    "ResetRequest",
    "ResetResult",
    "RobotDriver",
    "RobotSpec",
    "RobotState",
    "RunConfig",
    "SimulatedClock",
    "TaskError",
    "TrainResult",
    "UserError",
    "__version__",
    "deploy",
    "evaluate",
    "experiment",
    "load_config",
    "make_driver",
    "make_env",
    "make_task",
    "read_config",
    "register_envs",
    "report",
    "resume",
    "train",
]

_NAMES = {
    "drivers": (
        "ActionSpec",
        "AppliedCommand",
        "Box",
        "Command",
        "DriverError",
        "EndEffectorCommand",
        "GripperLimits",
        "Home",
        "InvalidRequest",
        "InvalidSpec",
        "JointCommand",
        "JointLimits",
        "JointSetpoint",
        "Kinematics",
        "Limits",
        "Mode",
        "MonotonicClock",
        "ObjectPose",
        "ObjectSource",
        "ResetOutcome",
        "ResetRequest",
        "ResetResult",
        "RobotDriver",
        "RobotSpec",
        "RobotState",
        "SimulatedClock",
        "make_driver",
    ),
    "iher_robot.config.options": ("load_config",),
    "iher_robot.config.run": ("RunConfig", "read_config"),
    "iher_robot.deployment.deploy": ("DeployResult", "deploy"),
    "iher_robot.env.goal_env": ("GoalRobotEnv", "make_env"),
    "iher_robot.evaluation.evaluate": ("EvaluationResult", "evaluate"),
    "iher_robot.experiments.experiment": ("ExperimentResult", "experiment"),
    "iher_robot.experiments.report.report": ("ReportResult", "report"),
    "iher_robot.training.result": ("TrainResult",),
    "iher_robot.training.train": ("resume", "train"),
    "tasks": ("TASKS", "GoalModel", "GoalTask", "TaskError", "make_task"),
}
# Module of each name that is imported when it is first used: these need numpy, which takes a tenth
# of a second to load, or torch, which takes seconds.
_LAZY = {name: module for module, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> object:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_LAZY[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


register_envs_with_gymnasium()
