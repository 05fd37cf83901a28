"""Learn manipulation from minutes of robot time, on a simulated robot or a real one.

``iher_robot.train(task="push", budget_minutes=10)`` is what ``iher-robot train`` does. Importing
the package registers its Gymnasium environments, such as ``iher_robot/Push-v0``; torch and the
simulator are loaded when they are first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from iher_robot.neighbours import require_neighbours

__version__ = "0.1.0"

require_neighbours("drivers", "tasks")

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
from iher_robot.errors import UserError  # noqa: E402
from iher_robot.registration import register_envs  # noqa: E402
from tasks import TASKS, GoalModel, GoalTask, TaskError, make_task  # noqa: E402

if TYPE_CHECKING:
    from iher_robot.deploy import DeployResult, deploy
    from iher_robot.evaluate import EvaluationResult, evaluate
    from iher_robot.experiment import ExperimentResult, experiment
    from iher_robot.report import ReportResult, report
    from iher_robot.train import TrainResult, resume, train

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

# These need torch, which takes seconds to load. `train`, `deploy`, `evaluate`, `experiment` and
# `report` are modules that can be called: see callable_module.py.
_LAZY = {
    "DeployResult": "iher_robot.deploy",
    "EvaluationResult": "iher_robot.evaluate",
    "ExperimentResult": "iher_robot.experiment",
    "ReportResult": "iher_robot.report",
    "TrainResult": "iher_robot.train",
    "deploy": "iher_robot.deploy",
    "evaluate": "iher_robot.evaluate",
    "experiment": "iher_robot.experiment",
    "report": "iher_robot.report",
    "resume": "iher_robot.train",
    "train": "iher_robot.train",
}


def __getattr__(name: str) -> object:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = importlib.import_module(_LAZY[name])
    return home if home.__name__ == f"{__name__}.{name}" else getattr(home, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


register_envs()
