"""Summaries of runs and episodes for display."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iher_robot.datasets.outcome import achieved_goals, clipped, rewards, succeeded
from iher_robot.datasets.run_reader import RunData
from iher_robot.errors import UserError
from iher_robot.storage.accounts import Account
from iher_robot.storage.episode import StoredEpisode
from iher_robot.storage.robot_time import RobotTime
from tasks import GoalModel, ObservationLayout

# By suffix of an entry's name. The tasks observe velocities as displacements per tick.
_UNITS = {"_angvel": "rad/tick", "_vel": "m/tick", "_euler": "rad", "_pos": "m", "_rel": "m"}


@dataclass(frozen=True)
class RunLine:
    """One line about a run.

    Attributes:
        path: The run's folder.
        last_change: Time of the last write in it.
        problem: Why it cannot be read; then the fields below are empty. Empty if it can.
        task: Name of the task.
        robot: Driver and robot.
        algo: Name of the algorithm.
        preset: Name of the preset.
        seed: Seed of the run.
        episodes: Stored episodes.
        successes: Episodes that succeeded.
        robot_time: Robot time of each account that has episodes.
    """

    path: Path
    last_change: datetime
    problem: str = ""
    task: str = ""
    robot: str = ""
    algo: str = ""
    preset: str = ""
    seed: int = 0
    episodes: int = 0
    successes: int = 0
    robot_time: str = ""


@dataclass(frozen=True)
class EpisodeGroup:
    """The episodes of an account and an epoch.

    Attributes:
        account: Account that they were charged to.
        epoch: Epoch in which they were collected.
        episodes: Number of episodes.
        ticks: Stored ticks.
        invalid_ticks: Ticks that may not be learned from.
        clipped_ticks: Valid ticks whose applied action is not the requested one.
        mean_return: Mean sum of rewards.
        successes: Episodes that succeeded.
    """

    account: Account
    epoch: int
    episodes: int
    ticks: int
    invalid_ticks: int
    clipped_ticks: int
    mean_return: float
    successes: int


@dataclass(frozen=True)
class RunReport:
    """Description of a run's data.

    Attributes:
        title: Task, robot, algorithm, preset and seed.
        facts: Further facts by name.
        groups: Its episodes, by account and epoch.
    """

    title: str
    facts: Mapping[str, str]
    groups: tuple[EpisodeGroup, ...]


@dataclass(frozen=True)
class EpisodeReport:
    """An episode, tick by tick.

    Attributes:
        title: Task, account, seed, ending and goal.
        stored: The episode.
        achieved: The goal that each tick achieved, m. ``(length, goal_dim)``
        distance: Distance from there to the goal, m. ``(length,)``
    """

    title: str
    stored: StoredEpisode
    achieved: NDArray[np.floating]
    distance: NDArray[np.floating]


def summarize_run(run: RunData) -> RunLine:
    """Summarize a run, even a damaged one."""
    try:
        config, stored = run.config, list(run.episodes())
        return RunLine(
            path=run.path,
            last_change=run.last_change,
            task=config.task,
            robot=config.chosen_robot.title,
            algo=config.algo,
            preset=Path(config.preset).stem,
            seed=config.seed,
            episodes=len(stored),
            successes=sum(succeeded(one, run.task.goal_model) for one in stored),
            robot_time=_robot_time(run, stored),
        )
    except UserError as error:
        return RunLine(path=run.path, last_change=run.last_change, problem=str(error))


def describe_run(run: RunData) -> RunReport:
    """Describe the data of a run.

    Raises:
        UserError: A part of the run is damaged.
    """
    config, stored = run.config, list(run.episodes())
    return RunReport(
        title=(
            f"{config.task} on {config.chosen_robot.title}, {config.algo}, {config.preset}, "
            f"seed {config.seed}"
        ),
        facts={
            "folder": str(run.path),
            "last change": f"{run.last_change:%Y-%m-%d %H:%M:%S}",
            "provenance": _provenance(run.provenance),
            "observation": _entries(run.task.layout),
            "goal": f"{goal_entry(run.task.goal_model)} within {run.task.threshold:g} m",
            "layout": run.task.layout.digest(),
            "interface": _interface(run),
            "robot time": _robot_time(run, stored) or "none",
        },
        groups=_groups(stored, run.task.goal_model),
    )


def describe_episode(run: RunData, index: int) -> EpisodeReport:
    """Describe an episode tick by tick.

    Args:
        run: The run.
        index: Index of the episode in the run, from 0.

    Raises:
        UserError: There is no such episode, or it is damaged.
    """
    stored, model = run.load(index), run.task.goal_model
    achieved, goal = achieved_goals(stored, model), stored.episode.desired_goal
    place = ", ".join(f"{value:.3f}" for value in goal)
    return EpisodeReport(
        title=(
            f"episode {index} of {run.path}: {run.config.task}, {stored.account} of epoch "
            f"{stored.epoch}, seed {stored.seed}, {stored.ended}; the goal is ({place}) m, "
            f"reached within {run.task.threshold:g} m"
        ),
        stored=stored,
        achieved=achieved,
        distance=model.distance(achieved, goal),
    )


def units(layout: ObservationLayout) -> dict[str, str]:
    """Unit of each entry of an observation, as far as its name implies one."""
    endings = {name: [end for end in _UNITS if name.endswith(end)] for name in layout.names}
    return {name: _UNITS[ends[0]] for name, ends in endings.items() if ends}


def goal_entry(model: GoalModel) -> str:
    """Name of the observation entry that is compared with the goal."""
    layout = model.layout
    return next(name for name in layout.names if layout.entries(name) == model.achieved_entries)


def counted(count: int, name: str) -> str:
    """A number with its noun, such as ``"1 episode"`` or ``"12 ticks"``."""
    return f"{count} {name}{'' if count == 1 else 's'}"


def _robot_time(run: RunData, stored: Iterable[StoredEpisode]) -> str:
    if run.robot is None:
        return ""
    parts = []
    for account in sorted({one.account for one in stored}, key=_motion_first):
        spent = RobotTime(run.spent_ticks[account], run.robot.control_period_s)
        parts.append(f"{account} {spent.minutes:.2f} min")
    return ", ".join(parts)


def _motion_first(account: Account) -> tuple[bool, str]:
    return account != "motion", account


def _entries(layout: ObservationLayout) -> str:
    known = units(layout)
    named = (f"{name} {size}{_in_brackets(known.get(name))}" for name, size in layout.sizes)
    return f"{layout.obs_dim} numbers: {', '.join(named)}"


def _in_brackets(unit: str | None) -> str:
    return "" if unit is None else f" ({unit})"


def _interface(run: RunData) -> str:
    if run.robot is None:
        return "unknown before the run has begun"
    return run.robot.interface_digest


def _provenance(document: Mapping[str, Any]) -> str:
    if not document:
        return "unknown before the run has begun"
    changed = " and changes" if document.get("dirty") else ""
    times = len(document.get("resumed", ()))
    resumed = f", resumed {times} times" if times else ""
    return f"commit {document.get('commit')}{changed}, started {document.get('started')}{resumed}"


def _groups(stored: Iterable[StoredEpisode], model: GoalModel) -> tuple[EpisodeGroup, ...]:
    grouped: dict[tuple[Account, int], list[StoredEpisode]] = {}
    for one in stored:
        grouped.setdefault((one.account, one.epoch), []).append(one)
    keys = sorted(grouped, key=lambda key: (_motion_first(key[0]), key[1]))
    return tuple(_group(*key, grouped[key], model) for key in keys)


def _group(
    account: Account, epoch: int, stored: list[StoredEpisode], model: GoalModel
) -> EpisodeGroup:
    return EpisodeGroup(
        account=account,
        epoch=epoch,
        episodes=len(stored),
        ticks=sum(len(one.episode) for one in stored),
        invalid_ticks=sum(int((~one.episode.valid).sum()) for one in stored),
        clipped_ticks=sum(int(clipped(one).sum()) for one in stored),
        mean_return=float(np.mean([rewards(one, model).sum() for one in stored])),
        successes=sum(succeeded(one, model) for one in stored),
    )
