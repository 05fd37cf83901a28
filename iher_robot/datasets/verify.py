"""Checks that a run's files are whole and belong together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
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
    """What a check found.

    Attributes:
        episodes: Episodes that are whole, those that the run began with included.
        ticks: Ticks in them.
        problems: A sentence for each thing that is damaged.
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
        """Each problem, and what all of it comes to in a last line."""
        found = counted(len(self.problems), "problem") if self.problems else "all whole"
        total = f"{counted(self.episodes, 'episode')}, {counted(self.ticks, 'tick')}: {found}"
        return "\n".join([*self.problems, total])


def check_run(run: RunData) -> Verification:
    """Check every file of a run, and that its parts belong together.

    Args:
        run: The run; one that goes on is checked as far as it has got.
    """
    problems: list[str] = []
    with _noted(problems):
        _ = run.config
    configured = not problems
    with _noted(problems):
        run.directory.check_config()
    # A run that goes on charges an episode, stores it, and then tells of it: read last to first.
    told = 0
    with _noted(problems):
        told = _episodes_told(run)
    before = len(problems)
    stored = list(_whole_episodes(run.directory.episodes_path, problems))
    if len(problems) == before:
        with _noted(problems):
            _check_told(run, told, stored)
    earlier = list(_whole_episodes(run.directory.warm_start_path, problems))
    if configured:
        for one in stored + earlier:
            with _noted(problems):
                run.require_own_task(one)
        with _noted(problems):
            _ = run.robot
    with _noted(problems):
        _check_ledger(run, stored)
    with _noted(problems):
        _ = run.provenance
    with _noted(problems):
        read_result(run.directory.result_path)
    for path in (run.directory.policy_path, run.directory.checkpoint_path):
        with _noted(problems):
            _check_torch_file(path)
    ticks = sum(len(one.episode) for one in stored + earlier)
    return Verification(len(stored) + len(earlier), ticks, tuple(dict.fromkeys(problems)))


@contextmanager
def _noted(problems: list[str]) -> Iterator[None]:
    try:
        yield
    except UserError as error:
        problems.append(str(error))


def _whole_episodes(directory: Path, problems: list[str]) -> Iterator[StoredEpisode]:
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
                f"{run.directory.ledger_path} counts {found[account]} ticks of {account}, and "
                f"{ticks} are stored; put the ledger back that belongs to the episodes"
            )


def _episodes_told(run: RunData) -> int:
    """Episodes of motion that the metrics tell of."""
    rows = run.directory.read_metrics()
    told = rows[-1].get("episodes", 0) if rows else 0
    if not isinstance(told, int):
        raise UserError(f"{run.directory.metrics_path} is damaged: episodes is {told!r}")
    return told


def _check_told(run: RunData, told: int, stored: Iterable[StoredEpisode]) -> None:
    collected = sum(one.account == "motion" for one in stored)
    if told > collected:
        raise UserError(
            f"{run.directory.metrics_path} tells of {told} episodes of motion, and {collected} are "
            "stored; put the episodes and their index back that belong to it"
        )


def _check_torch_file(path: Path) -> None:
    if path.exists():
        kind = f"{path.stem} file"
        check_zip(read_file(path, kind), path, kind)
