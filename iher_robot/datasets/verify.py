"""Checks that the files of a run are intact and belong together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from iher_robot.datasets.run_reader import RunData, examine_store
from iher_robot.datasets.summary import counted
from iher_robot.errors import UserError
from iher_robot.storage.accounts import Account
from iher_robot.storage.episode import StoredEpisode
from iher_robot.storage.files.atomic import read_file
from iher_robot.storage.files.checksum import check_zip
from iher_robot.storage.run_result import read_result


@dataclass(frozen=True)
class Verification:
    """Result of a check.

    Attributes:
        episodes: Intact episodes, including those of earlier runs that the run began with.
        ticks: Their ticks.
        problems: One sentence for each problem.
    """

    episodes: int
    ticks: int
    problems: tuple[str, ...]

    def __add__(self, other: Verification) -> Verification:
        return Verification(
            self.episodes + other.episodes,
            self.ticks + other.ticks,
            self.problems + other.problems,
        )

    def summary(self) -> str:
        """Each problem on a line, then the total."""
        found = counted(len(self.problems), "problem") if self.problems else "no problems"
        total = f"{counted(self.episodes, 'episode')}, {counted(self.ticks, 'tick')}: {found}"
        return "\n".join([*self.problems, total])


def check_run(run: RunData) -> Verification:
    """Check every file of a run, and that its parts belong together.

    Args:
        run: The run; if it is in progress, what it has written so far.
    """
    problems: list[str] = []
    with _collect(problems):
        _ = run.config
    configured = not problems
    with _collect(problems):
        run.directory.check_config()
    stored = _check_episodes(run, problems)
    earlier = list(_intact_episodes(run.directory.warm_start_path, problems))
    if configured:
        _check_interface(run, stored + earlier, problems)
    for check in (
        partial(_check_ledger, run, stored),
        lambda: run.provenance,
        partial(read_result, run.directory.result_path),
        partial(_check_torch_file, run.directory.policy_path),
        partial(_check_torch_file, run.directory.checkpoint_path),
    ):
        with _collect(problems):
            check()
    ticks = sum(len(one.episode) for one in stored + earlier)
    return Verification(len(stored) + len(earlier), ticks, tuple(dict.fromkeys(problems)))


@contextmanager
def _collect(problems: list[str]) -> Iterator[None]:
    """Add a `UserError` of the block to the problems."""
    try:
        yield
    except UserError as error:
        problems.append(str(error))


def _check_episodes(run: RunData, problems: list[str]) -> list[StoredEpisode]:
    """The intact episodes of the run itself."""
    # A run in progress charges an episode, stores it, then reports it: read in reverse order.
    reported = 0
    with _collect(problems):
        reported = _reported_episodes(run)
    before = len(problems)
    stored = list(_intact_episodes(run.directory.episodes_path, problems))
    if len(problems) == before:
        with _collect(problems):
            _check_metrics(run, reported, stored)
    return stored


def _check_interface(run: RunData, stored: Iterable[StoredEpisode], problems: list[str]) -> None:
    for one in stored:
        with _collect(problems):
            run.require_own_task(one)
    with _collect(problems):
        _ = run.robot


def _intact_episodes(directory: Path, problems: list[str]) -> Iterator[StoredEpisode]:
    for found in examine_store(directory):
        if isinstance(found, UserError):
            problems.append(str(found))
        else:
            yield found


def _check_ledger(run: RunData, stored: Iterable[StoredEpisode]) -> None:
    charged = Counter[Account]()
    for one in stored:
        charged[one.account] += int(one.elapsed.sum())
    if not charged and not run.directory.ledger_path.exists():
        return  # the run has not begun
    found = run.spent_ticks
    for account, ticks in charged.items():
        if found[account] < ticks:
            raise UserError(
                f"{run.directory.ledger_path} counts {found[account]} ticks of {account}, but "
                f"{ticks} are stored; restore the ledger that belongs to the episodes"
            )


def _reported_episodes(run: RunData) -> int:
    """Episodes of motion that the metrics report."""
    rows = run.directory.read_metrics()
    reported = rows[-1].get("episodes", 0) if rows else 0
    if not isinstance(reported, int):
        raise UserError(f"{run.directory.metrics_path} is damaged: episodes is {reported!r}")
    return reported


def _check_metrics(run: RunData, reported: int, stored: Iterable[StoredEpisode]) -> None:
    collected = sum(one.account == "motion" for one in stored)
    if reported > collected:
        raise UserError(
            f"{run.directory.metrics_path} reports {reported} episodes of motion, but {collected} "
            "are stored; restore the episodes and the index that belong to it"
        )


def _check_torch_file(path: Path) -> None:
    if path.exists():
        kind = f"{path.stem} file"
        check_zip(read_file(path, kind), path, kind)
