"""Compare the folder of a killed run with the host's record."""

from __future__ import annotations

import itertools
import json
import shutil
import sqlite3
import tempfile
from collections import Counter
from collections.abc import Collection, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from iher_robot.evaluation.compatibility import load_trained_policy
from iher_robot.storage.checkpoint import load_checkpoint
from iher_robot.storage.episode import DONE, StoredEpisode
from iher_robot.storage.episode_reader import EpisodeReader
from iher_robot.storage.episode_store import CUT_OFF, EpisodeStore
from iher_robot.storage.ledger import Ledger
from tests.faults.host_log import LoggedTick
from tests.faults.violation import Violation
from tests.in_place import as_if_left_there

OVERCOUNT_PER_KILL = 1
"""Ticks that a ledger may over-count for each kill: the one in flight."""


@dataclass(frozen=True)
class Witness:
    """The host's record of a run.

    Attributes:
        true_ticks: Numbers of the ticks in which a command of the run was in force.
        last_ticks: The last of them of each killed process, which may have been in flight.
    """

    true_ticks: Collection[int]
    last_ticks: Collection[int]

    @staticmethod
    def of(killed: Sequence[Sequence[LoggedTick]], unharmed: Sequence[LoggedTick] = ()) -> Witness:
        """Build the record from the log of each process.

        Args:
            killed: Logged ticks of each killed process.
            unharmed: Logged ticks of the process that ended by itself.
        """
        commanded = [[tick.seq for tick in ticks if tick.commanded] for ticks in killed]
        others = [tick.seq for tick in unharmed if tick.commanded]
        last = [seqs[-1] for seqs in commanded if seqs]
        return Witness(frozenset(itertools.chain(others, *commanded)), frozenset(last))


@dataclass
class Found:
    """Content of a run's folder.

    Attributes:
        spent: Ticks in the ledger, by account.
        covered: Ticks of the robot in stored episodes, with their number of occurrences.
        valid: Those of them that may be learned from.
        unseen: Ticks that were charged but not observed.
        aborted: Ticks of the last step of an aborted episode, charged and without observation.
        left: Unfinished work that the kill left, empty if none.
    """

    spent: dict[str, int]
    covered: Counter[int] = field(default_factory=Counter)
    valid: set[int] = field(default_factory=set)
    unseen: int = 0
    aborted: set[int] = field(default_factory=set)
    left: str = ""

    @property
    def total(self) -> int:
        return self.spent["motion"] + self.spent["evaluation"]


def look_into(folder: Path, scratch: Path) -> Found:
    """Read the folder of a killed run as a resumption would.

    Reads a copy, so that the resumption itself still has to recover everything.

    Args:
        folder: The run's folder.
        scratch: Folder for the copy.
    """
    with tempfile.TemporaryDirectory(dir=scratch) as copy_name:
        copy = Path(copy_name) / "run"
        shutil.copytree(folder, copy, ignore=shutil.ignore_patterns("filler", "tensorboard"))
        as_if_left_there(copy)
        left = _left(copy)
        with Ledger(copy / "ledger.sqlite") as ledger:
            found = Found(
                {
                    "motion": ledger.spent_ticks("motion"),
                    "evaluation": ledger.spent_ticks("evaluation"),
                },
                left=left,
            )
        if (copy / "episodes").is_dir():
            with EpisodeStore(copy / "episodes") as store:
                settled = _settled(copy / "ledger.sqlite")
                for episode in store:
                    _add(found, episode, settled.get(episode.entry))
        load_checkpoint(copy / "checkpoint.pt")
        if (copy / "policy.pt").exists():
            load_trained_policy(copy / "policy.pt")
    return found


def _left(folder: Path) -> str:
    """Name the unfinished work in the folder of a run."""
    for name in ("checkpoint", "policy"):
        if any(folder.glob(f".{name}*.tmp")):
            return f"a {name} half written"
    if any(folder.glob("episodes/.episode-*.tmp")):
        return "an episode half sealed"
    if (folder / "episodes" / "index.sqlite").exists():
        with EpisodeReader(folder / "episodes") as reader:
            if reader.path(len(reader)).exists():
                return "an episode sealed, and not in the index"
            if reader.running is not None and reader.running.ticks:
                return f"an episode under way ({reader.running.header.account})"
    state = load_checkpoint(folder / "checkpoint.pt")
    if len(_rows(folder)) > (0 if state is None else state["learner"]["epoch"]):
        return "metrics written, and the checkpoint not"
    return ""


def _rows(folder: Path) -> list[dict[str, float]]:
    path = folder / "metrics.jsonl"
    return list(map(json.loads, path.read_text().splitlines())) if path.exists() else []


def _settled(ledger: Path) -> dict[int, int]:
    with closing(sqlite3.connect(ledger)) as database:
        query = "SELECT reservation, ticks FROM entry WHERE kind = 'settle'"
        return dict(database.execute(query).fetchall())


def _add(found: Found, episode: StoredEpisode, charged: int | None) -> None:
    for seq, elapsed, valid in zip(
        episode.seqs.tolist(), episode.elapsed.tolist(), episode.episode.valid, strict=True
    ):
        found.covered.update(range(seq - elapsed + 1, seq + 1))
        found.unseen += elapsed - 1
        if valid:
            found.valid.add(seq)
    if charged is None:  # the whole reservation counts
        return
    beyond = charged - int(episode.elapsed.sum())
    if beyond < 0:
        raise Violation(f"episode {episode.index} is charged {charged} ticks and has more")
    if episode.ended not in (DONE, CUT_OFF):
        last = int(episode.seqs[-1])
        found.aborted.update(range(last + 1, last + beyond + 1))


def compare(found: Found, witness: Witness, kills: int) -> int:
    """Check that no tick is missing, repeated or invented, and that the ledger counts them all.

    Args:
        found: Content of the run's folder.
        witness: The host's record.
        kills: Kills of the run.

    Returns:
        Ticks that the ledger over-counts.

    Raises:
        Violation: Ticks are missing, repeated, invented or miscounted.
    """
    twice = sorted(seq for seq, times in found.covered.items() if times > 1)
    if twice:
        raise Violation(f"ticks {twice} are stored more than once")
    stored = found.covered.keys() | found.aborted
    missing = set(witness.true_ticks) - stored - set(witness.last_ticks)
    if missing:
        raise Violation(
            f"ticks {sorted(missing)} are missing from the episodes; in flight may have been "
            f"{sorted(witness.last_ticks)}"
        )
    invented = found.valid - set(witness.true_ticks)
    if invented:
        raise Violation(f"ticks {sorted(invented)} are stored, but no command was in force in them")
    known = len(set(witness.true_ticks) | stored)
    if found.total < known:
        raise Violation(f"the ledger counts {found.spent}, but {known} ticks have passed")
    over = found.total - known
    if over > OVERCOUNT_PER_KILL * kills:
        raise Violation(
            f"the ledger counts {found.spent}, {over} more than the {known} ticks that have "
            f"passed, after {kills} kills"
        )
    return over


def check_finished(folder: Path, found: Found, budget_ticks: int) -> None:
    """Check a run that has spent its budget.

    Args:
        folder: The run's folder.
        found: Its content.
        budget_ticks: Its budget.

    Raises:
        Violation: Something is missing, or it spent another number of ticks.
    """
    motion = found.spent["motion"]
    if not budget_ticks <= motion <= budget_ticks + found.unseen:
        raise Violation(f"{motion} ticks of motion were spent of a budget of {budget_ticks}")
    rows = _rows(folder)
    epochs = [row["epoch"] for row in rows]
    if epochs != list(range(1, len(rows) + 1)):
        raise Violation(f"the metrics have epochs {epochs}")
    minutes = [row["robot_minutes"] for row in rows]
    if minutes != sorted(minutes):
        raise Violation(f"robot minutes fall: {minutes}")
    checkpoint = load_checkpoint(folder / "checkpoint.pt")
    if checkpoint is None or checkpoint["learner"]["epoch"] != len(rows):
        raise Violation("the checkpoint is not that of the last epoch")
    load_trained_policy(folder / "policy.pt")
