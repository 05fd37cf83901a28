"""Which episodes are exported together, and what is said of all of them."""

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

NEEDED = "pip install 'iher-robot[data]'"
"""How the packages of the exports are installed."""


@dataclass(frozen=True)
class Selection:
    """Episodes of one task, out of one or several runs.

    Attributes:
        runs: The runs, by the name that their episodes bear.
        account: Which of their episodes.
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
            UserError: One is damaged.
        """
        for name, run in self.runs.items():
            for stored in run.episodes():
                if self.account in ("all", stored.account):
                    yield name, stored

    def describe(self) -> dict[str, Any]:
        """What holds for all, and for each run by its name; plain JSON data.

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
    """Open runs whose episodes go together.

    Args:
        paths: The runs' folders.
        account: ``motion``, ``evaluation`` or ``all``.

    Yields:
        Their episodes.

    Raises:
        UserError: There is no run, one is given twice or damaged, they are of different tasks or
            their actions mean different things, or they hold no such episode.
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
    """The folder's name where no two runs share it, else the whole path."""
    paths = [run.path.resolve() for run in runs]
    for path, count in Counter(paths).items():
        if count > 1:
            raise UserError(f"{path} is given {count} times; name each run once")
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
                "export the runs of each task on their own"
            )
        if None not in (run.robot, first.robot) and _meaning(run) != _meaning(first):
            raise UserError(
                f"the actions of {first.path} and {run.path} mean different things "
                f"({_meaning(first)} and {_meaning(run)}); export each on its own"
            )


def _meaning(run: RunData) -> dict[str, Any]:
    """What an action is and how long it lasts."""
    assert run.robot is not None
    return {**run.robot.spec["action"], "control_period_s": run.robot.control_period_s}


def _describe(run: RunData) -> dict[str, Any]:
    config, robot = run.config, run.robot
    known = {} if robot is None else _meaning(run)
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
