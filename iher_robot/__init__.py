"""Learn manipulation from minutes of robot time, on a simulated robot or a real one.

``iher_robot.train(task="push", budget_minutes=10)`` is what ``iher-robot train`` does. Importing
the package registers its Gymnasium environments, such as ``iher_robot/Push-v0``; torch and the
simulator are loaded when they are first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from iher_robot._shadowing import require_own_packages
from iher_robot.version import __version__

require_own_packages("drivers", "tasks")

from drivers import (  # noqa: E402  (only once it is known that these are ours)
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
from iher_robot.env import GoalRobotEnv, make_env  # noqa: E402
from iher_robot.env.registration import register_envs  # noqa: E402
from iher_robot.errors import UserError  # noqa: E402
from tasks import TASKS, GoalModel, GoalTask, TaskError, make_task  # noqa: E402

if TYPE_CHECKING:
    from iher_robot.deployment.deploy import DeployResult, deploy
    from iher_robot.evaluation.evaluate import EvaluationResult, evaluate
    from iher_robot.experiments.experiment import ExperimentResult, experiment
    from iher_robot.experiments.report.report import ReportResult, report
    from iher_robot.training.train import TrainResult, resume, train

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
    "SimulatedClock",
    "TaskError",
    "TrainResult",
    "UserError",
    "__version__",
    "deploy",
    "evaluate",
    "experiment",
    "make_driver",
    "make_env",
    "make_task",
    "register_envs",
    "report",
    "resume",
    "train",
]

# These need torch, which takes seconds to load.
_LAZY = {
    "DeployResult": "iher_robot.deployment.deploy",
    "EvaluationResult": "iher_robot.evaluation.evaluate",
    "ExperimentResult": "iher_robot.experiments.experiment",
    "ReportResult": "iher_robot.experiments.report.report",
    "TrainResult": "iher_robot.training.train",
    "deploy": "iher_robot.deployment.deploy",
    "evaluate": "iher_robot.evaluation.evaluate",
    "experiment": "iher_robot.experiments.experiment",
    "report": "iher_robot.experiments.report.report",
    "resume": "iher_robot.training.train",
    "train": "iher_robot.training.train",
}


def __getattr__(name: str) -> object:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_LAZY[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


register_envs()
