"""Gymnasium goal environment, its controllers, and the operator."""

from __future__ import annotations

from iher_robot.env.goal_env import GoalRobotEnv, make_env

__all__ = ["GoalRobotEnv", "make_env"]
