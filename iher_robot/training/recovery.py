"""Recovery of a stopped run: its state, read from the run folder and checked."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from iher_robot.config.run import RunConfig, dump_identity
from iher_robot.errors import UserError
from iher_robot.learning.episode import Episode
from iher_robot.storage.accounts import Account
from iher_robot.storage.checkpoint import load_checkpoint
from iher_robot.storage.episode import DONE, StoredEpisode
from iher_robot.storage.episode_reader import EpisodeReader
from iher_robot.storage.episode_store import CUT_OFF, EpisodeStore
from iher_robot.storage.ledger import Ledger
from iher_robot.storage.run_directory import RunDirectory
from iher_robot.training.epoch import EpochData


@dataclass(frozen=True)
class Restored:
    """State of a run at its last checkpoint, and the episodes since.

    Attributes:
        learner: State of the learner, None before the first checkpoint.
        rows: Metrics of the finished epochs.
        by_epoch: Real episodes of each finished epoch, those of earlier runs in the first.
        pending: Epochs collected since, in order, and not learned from yet.
        collected: Real episodes that this run collected.
    """

    learner: dict[str, Any] | None
    rows: list[dict[str, float]]
    by_epoch: list[list[Episode]]
    pending: list[EpochData]
    collected: int


def restore(
    directory: RunDirectory, config: RunConfig, store: EpisodeStore, ledger: Ledger
) -> Restored:
    """Read a run folder and check that its parts belong together.

    Nothing is written but the settlement of what a crash left open in the ledger and an episode
    accounts for.

    Args:
        directory: The run folder, new or of a stopped run.
        config: Settings that the run is about to go on with.
        store: Its real episodes.
        ledger: Its accounts.

    Returns:
        The state to go on from.

    Raises:
        UserError: A part is missing, damaged, or older than another.
    """
    state = load_checkpoint(directory.checkpoint_path)
    newest_entry = 0 if state is None else int(state["run"]["ledger_entry"])
    by_epoch, ticks = _read_epochs(store, ledger, newest_entry)
    collected = sum(map(len, by_epoch.values()))
    if config.from_data:
        by_epoch[1] = _read_warm_start(directory)
    finished = 0 if state is None else int(state["learner"]["epoch"])
    newest = max(by_epoch, default=0)
    # An asynchronous run learns an epoch while it collects the next one.
    ahead = 2 if config.asynchronous else 1
    if newest > finished + ahead:
        raise UserError(
            f"{directory.checkpoint_path} is missing or too old: it ends with epoch {finished}, "
            f"but there are episodes of epoch {newest}; put the newest one back"
        )
    pending = [
        EpochData(number, by_epoch[number], ticks[number])
        for number in range(finished + 1, newest + 1)
    ]
    if state is None:
        if config.from_data:
            pending[0].earlier = True
        return Restored(None, [], [], pending, collected)
    found = collected - sum(len(epoch.episodes) for epoch in pending)
    _check_run(state["run"], directory, config, finished, found)
    epochs = [by_epoch[epoch] for epoch in range(1, finished + 1)]
    return Restored(state["learner"], state["run"]["rows"], epochs, pending, collected)


def _read_epochs(
    store: EpisodeStore, ledger: Ledger, newest_entry: int
) -> tuple[dict[int, list[Episode]], dict[int, int]]:
    """Read the episodes of motion and their ticks, by epoch, and check them with the ledger."""
    by_epoch: dict[int, list[Episode]] = defaultdict(list)
    ticks: dict[int, int] = defaultdict(int)
    spent: dict[Account, int] = defaultdict(int)
    for stored in store:
        _settle(stored, store, ledger)
        spent[stored.account] += int(stored.elapsed.sum())
        newest_entry = max(newest_entry, stored.entry)
        if stored.account == "motion":
            by_epoch[stored.epoch].append(stored.episode)
            ticks[stored.epoch] += int(stored.elapsed.sum())
    _check_ledger(ledger, spent, newest_entry)
    return by_epoch, ticks


def _check_run(
    run: Mapping[str, Any], directory: RunDirectory, config: RunConfig, finished: int, found: int
) -> None:
    """Check that settings and episodes are those of the checkpoint."""
    if run["config"] != dump_identity(config):
        raise UserError(
            f"{directory.config_path} has changed since the run began; restore it, or start a new "
            "run with another --out"
        )
    if found != run["episodes"]:
        raise UserError(
            f"{directory.episodes_path} holds {found} episodes of the epochs up to {finished}, "
            f"the run collected {run['episodes']}; put the missing files back"
        )


def _settle(stored: StoredEpisode, store: EpisodeStore, ledger: Ledger) -> None:
    """Settle what an episode was reserved, if a crash of the machine came before it was.

    A tick is on the disk before the next one begins, so that at most one more has begun.
    """
    if stored.entry not in ledger.open_reservations:
        return
    used = int(stored.elapsed.sum())
    if stored.ended == DONE:
        ledger.settle(stored.entry, used)
    elif stored.ended == CUT_OFF and store.durable_ticks:
        ledger.settle(stored.entry, used + 1)
    # Else its last ticks may be lost, or not be recorded: the whole reservation counts, for good.


def _check_ledger(ledger: Ledger, spent: dict[Account, int], newest_entry: int) -> None:
    for account, ticks in spent.items():
        if ledger.spent_ticks(account) < ticks:
            raise UserError(
                f"{ledger.path} counts {ledger.spent_ticks(account)} ticks of {account}, but the "
                f"stored episodes hold {ticks}: it lost entries; put the whole ledger back"
            )
    if ledger.last_entry < newest_entry:
        raise UserError(
            f"{ledger.path} ends with entry {ledger.last_entry}, but entry {newest_entry} was "
            "written: it lost entries; put the whole ledger back"
        )


def _read_warm_start(directory: RunDirectory) -> list[Episode]:
    with EpisodeReader(directory.warm_start_path) as reader:
        return [stored.episode for stored in reader]
