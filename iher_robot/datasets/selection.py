"""Selection of the episodes to export, and their common metadata."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from iher_robot.datasets.run_reader import RunData
from iher_robot.datasets.summary import goal_entry, units
from iher_robot.errors import UserError, unknown_name
from iher_robot.storage.episode import StoredEpisode
from iher_robot.version import __version__
from tasks import GoalTask

ExportAccount = Literal["motion", "evaluation", "all"]

INSTALL_COMMAND = "pip install 'iher-robot[data]'"
"""Installs the packages that exports need."""


@dataclass(frozen=True)
class Selection:
    """Episodes of one task from one or more runs.

    Attributes:
        runs: The runs, by their name in the export.
        account: Account of the episodes.
    """

    runs: Mapping[str, RunData]
    account: ExportAccount

    @property
    def task(self) -> GoalTask:
        """The task of all runs, not bound to a robot."""
        return next(iter(self.runs.values())).task

    def episodes(self) -> Iterator[tuple[str, StoredEpisode]]:
        """Read the episodes, each with the name of its run.

        Raises:
            UserError: An episode is damaged.
        """
        for name, run in self.runs.items():
            for stored in run.episodes():
                if self.account in ("all", stored.account):
                    yield name, stored

    def describe(self) -> dict[str, Any]:
        """Metadata of the task and of each run, JSON values.

        Raises:
            UserError: A part of a run is damaged.
        """
        task = self.task
        return {
            "iher_robot": __version__,
            "task": task.name,
            "layout": task.layout.to_dict(),
            "layout_digest": task.layout.digest(),
            "units": units(task.layout),
            "goal": goal_entry(task.goal_model),
            "threshold_m": task.threshold,
            "account": self.account,
            "runs": {name: _describe(run) for name, run in self.runs.items()},
        }


@contextmanager
def select(paths: Sequence[Path], account: str) -> Iterator[Selection]:
    """Open runs to be exported together.

    Args:
        paths: The runs' folders.
        account: ``motion``, ``evaluation`` or ``all``.

    Yields:
        Their episodes.

    Raises:
        UserError: A run is missing, damaged or given twice, tasks or actions of the runs differ,
            or they hold no such episode.
    """
    accounts: tuple[ExportAccount, ...] = get_args(ExportAccount)
    if account not in accounts:
        raise unknown_name("account", account, accounts)
    with ExitStack() as stack:
        runs = _by_name([stack.enter_context(RunData(path)) for path in paths])
        chosen = accounts[accounts.index(account)]
        _require_one_task(list(runs.values()))
        selection = Selection(runs, chosen)
        if next(selection.episodes(), None) is None:
            kind = "" if chosen == "all" else f" of account {chosen!r}"
            where = ", ".join(str(run.path) for run in runs.values())
            raise UserError(f"there is no episode{kind} in {where}; name another run or account")
        yield selection


def _by_name(runs: Sequence[RunData]) -> dict[str, RunData]:
    """Name each run by its folder, or by its whole path where two folders have the same name."""
    paths = [run.path.resolve() for run in runs]
    for path, count in Counter(paths).items():
        if count > 1:
            raise UserError(f"{path} is given {count} times; give each run once")
    names = Counter(path.name for path in paths)
    return {
        path.name if names[path.name] == 1 else str(path): run
        for path, run in zip(paths, runs, strict=True)
    }


def _require_one_task(runs: Sequence[RunData]) -> None:
    first = runs[0]
    for run in runs[1:]:
        if run.task.name != first.task.name:
            raise UserError(
                f"{first.path} is of task {first.task.name!r}, {run.path} of {run.task.name!r}; "
                "export the runs of each task separately"
            )
        if None not in (run.robot, first.robot) and _action_meaning(run) != _action_meaning(first):
            raise UserError(
                f"the actions of {first.path} and {run.path} mean different things "
                f"({_action_meaning(first)} and {_action_meaning(run)}); export each separately"
            )


def _action_meaning(run: RunData) -> dict[str, Any]:
    """Names and scales of the actions, and the control period."""
    assert run.robot is not None
    return {**run.robot.spec["action"], "control_period_s": run.robot.control_period_s}


def _describe(run: RunData) -> dict[str, Any]:
    config, robot = run.config, run.robot
    known = {} if robot is None else _action_meaning(run)
    return {
        "algo": config.algo,
        "preset": config.preset,
        "seed": config.seed,
        "driver": config.driver,
        "robot": config.robot,
        "robot_options": config.robot_options,
        "interface_digest": None if robot is None else robot.interface_digest,
        "body_digest": None if robot is None else robot.body_digest,
        "action": known,
        "provenance": run.provenance,
    }
