"""Goals, rewards and success of a stored episode."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from iher_robot.storage.episode import DONE, StoredEpisode
from tasks import GoalModel


def achieved_goals(stored: StoredEpisode, model: GoalModel) -> NDArray[np.floating]:
    """The goal that each tick achieved, m, in the robot's frame. ``(length, goal_dim)``"""
    return model.achieved_goal(stored.episode.observations[1:])


def rewards(stored: StoredEpisode, model: GoalModel) -> NDArray[np.floating]:
    """The task's sparse reward of each tick, 0 or -1. ``(length,)``"""
    return model.compute_reward(achieved_goals(stored, model), stored.episode.desired_goal)


def reached(stored: StoredEpisode, model: GoalModel) -> NDArray[np.bool_]:
    """Whether each tick ended at the goal. ``(length,)``"""
    success = model.is_success(achieved_goals(stored, model), stored.episode.desired_goal)
    return success.astype(bool)


def succeeded(stored: StoredEpisode, model: GoalModel) -> bool:
    """Whether an episode ran to its last tick and ended at the goal."""
    return stored.ended == DONE and bool(reached(stored, model)[-1])


def clipped(stored: StoredEpisode) -> NDArray[np.bool_]:
    """Whether a tick is valid, but its applied action is not the requested one. ``(length,)``"""
    episode = stored.episode
    requested = np.clip(episode.requested_actions, -1.0, 1.0)
    differs: NDArray[np.bool_] = (requested != episode.actions).any(axis=-1)
    return differs & episode.valid
