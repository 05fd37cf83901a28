"""What a run folder holds, checked before a run goes on from it."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any

from iher_robot.checkpoint import load_checkpoint
from iher_robot.config import RunConfig, dump_config
from iher_robot.episode_store import EpisodeStore
from iher_robot.errors import UserError
from iher_robot.learning.episode import Episode
from iher_robot.run_directory import RunDirectory


@dataclass(frozen=True)
class Restored:
    """State of a run at its last checkpoint, and what came after.

    Attributes:
        learner: What ``Learner.state_dict`` returned, None before the first checkpoint.
        rows: Metrics of the finished epochs.
        by_epoch: Real episodes of each finished epoch.
        pending: Real episodes of the epoch that was under way.
    """

    learner: dict[str, Any] | None
    rows: list[dict[str, float]]
    by_epoch: list[list[Episode]]
    pending: list[Episode]


def restore(
    directory: RunDirectory, config: RunConfig, store: EpisodeStore, spent_ticks: int
) -> Restored:
    """Read a run folder and check that its parts belong together. Nothing is written.

    Args:
        directory: The run folder, new or of a stopped run.
        config: Settings that the run is about to go on with.
        store: Its real episodes.
        spent_ticks: Control ticks of motion on its ledger.

    Returns:
        The state to go on from.

    Raises:
        UserError: A part is missing, damaged, or older than another.
    """
    state = load_checkpoint(directory.checkpoint_path)
    by_epoch: dict[int, list[Episode]] = defaultdict(list)
    for stored in store:
        if stored.account == "motion":
            by_epoch[stored.epoch].append(stored.episode)
    ticks = sum(len(episode) for episodes in by_epoch.values() for episode in episodes)
    if spent_ticks < ticks:
        raise UserError(
            f"{directory.ledger_path} counts {spent_ticks} ticks of motion, but the stored "
            f"episodes hold {ticks}: it lost entries; put the whole ledger back"
        )
    finished = 0 if state is None else int(state["learner"]["epoch"])
    newest = max(by_epoch, default=0)
    if newest > finished + 1:
        raise UserError(
            f"{directory.checkpoint_path} is missing or too old: it ends with epoch {finished}, "
            f"but there are episodes of epoch {newest}; put the newest one back"
        )
    pending = by_epoch[finished + 1]
    if state is None:
        return Restored(None, [], [], pending)
    run = state["run"]
    if run["config"] != dump_config(config):
        raise UserError(
            f"{directory.config_path} is not what the run was started with; put it back, or start "
            "a new run with another --out"
        )
    epochs = [by_epoch[epoch] for epoch in range(1, finished + 1)]
    found = sum(map(len, epochs))
    if found != run["episodes"]:
        raise UserError(
            f"{directory.episodes_path} holds {found} episodes of the epochs up to {finished}, "
            f"the run collected {run['episodes']}; put the missing files back"
        )
    return Restored(state["learner"], run["rows"], epochs, pending)
