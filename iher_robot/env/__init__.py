"""Gymnasium goal environment, its controllers, and the operator."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from iher_robot.env.goal_env import GoalRobotEnv, make_env

__all__ = ["GoalRobotEnv", "make_env"]


# Imported when first used: `iher_robot` registers its environments without loading Gymnasium.
def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module("iher_robot.env.goal_env"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
