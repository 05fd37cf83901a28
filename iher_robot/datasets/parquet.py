"""Export to a Parquet file: one row for each tick, valid or not.

``_schema`` lists the columns. Numbers are exact: arrays of float32 are widened to float64.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from iher_robot.datasets.outcome import achieved_goals, reached, rewards
from iher_robot.datasets.selection import INSTALL_COMMAND, Selection
from iher_robot.datasets.summary import counted
from iher_robot.errors import UserError
from iher_robot.storage.episode import StoredEpisode
from iher_robot.storage.files.atomic import write_atomically
from tasks import GoalModel

if TYPE_CHECKING:
    import pyarrow as pa

METADATA_KEY = "iher_robot"
"""Key of the file's metadata: JSON with the meaning and the provenance of the columns."""

_EPISODES_PER_GROUP = 1000


@dataclass(frozen=True)
class ParquetResult:
    """Size of a Parquet file.

    Attributes:
        path: The file.
        episodes: Episodes in it.
        ticks: Rows in it.
        invalid_ticks: Rows that may not be learned from.
    """

    path: Path
    episodes: int
    ticks: int
    invalid_ticks: int

    def summary(self) -> str:
        """The result in one line."""
        return (
            f"{counted(self.episodes, 'episode')}, {counted(self.ticks, 'tick')} "
            f"({self.invalid_ticks} of them not valid): {self.path}"
        )


def write_parquet(selection: Selection, *, out: Path, overwrite: bool = False) -> ParquetResult:
    """Write episodes to a Parquet file.

    Args:
        selection: The episodes.
        out: The file.
        overwrite: Replace an existing file.

    Raises:
        UserError: The extra ``data`` is missing, an episode is damaged, or the file exists or
            cannot be written. Nothing is written.
    """
    _check_target(out, overwrite=overwrite)
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise UserError(
            f"Parquet files need pyarrow (the extra 'data'): {INSTALL_COMMAND}"
        ) from error
    model, counter = selection.task.goal_model, _Counter()
    schema = _schema(selection)
    episodes = counter.count(selection.episodes())

    def write(file: Any) -> None:
        with pq.ParquetWriter(file, schema, compression="zstd") as writer:
            while group := list(itertools.islice(episodes, _EPISODES_PER_GROUP)):
                batches = [_rows(name, stored, model, schema) for name, stored in group]
                writer.write_table(pa.Table.from_batches(batches, schema))

    write_atomically(out, write)
    return ParquetResult(out, counter.episodes, counter.ticks, counter.invalid_ticks)


def _check_target(out: Path, *, overwrite: bool) -> None:
    if out.is_dir():
        raise UserError(f"--out is {out}, which is a folder, allowed: a file")
    if not out.absolute().parent.is_dir():
        raise UserError(f"--out is {out}, but there is no folder {out.parent}; create it first")
    if out.exists() and not overwrite:
        raise UserError(f"{out} already exists; choose another --out, or use --overwrite")


class _Counter:
    """Counts the episodes of an iterator."""

    def __init__(self) -> None:
        self.episodes = self.ticks = self.invalid_ticks = 0

    def count(
        self, episodes: Iterator[tuple[str, StoredEpisode]]
    ) -> Iterator[tuple[str, StoredEpisode]]:
        for name, stored in episodes:
            self.episodes += 1
            self.ticks += len(stored.episode)
            self.invalid_ticks += int((~stored.episode.valid).sum())
            yield name, stored


def _schema(selection: Selection) -> pa.Schema:
    import pyarrow as pa

    _, first = next(selection.episodes())
    obs_dim, action_dim = first.episode.observations.shape[1], first.episode.actions.shape[1]
    goal_dim = len(first.episode.desired_goal)

    def numbers(length: int) -> pa.DataType:
        return pa.list_(pa.float64(), length)

    return pa.schema(
        {
            "run": pa.string(),
            "episode": pa.int64(),
            "tick": pa.int64(),
            "epoch": pa.int64(),
            "account": pa.string(),
            "seed": pa.int64(),
            "told_source": pa.int64(),
            "ended": pa.string(),
            "seq": pa.int64(),
            "elapsed": pa.int64(),
            "valid": pa.bool_(),
            "observation": numbers(obs_dim),
            "next_observation": numbers(obs_dim),
            "action_requested": numbers(action_dim),
            "action_applied": numbers(action_dim),
            "desired_goal": numbers(goal_dim),
            "achieved_goal": numbers(goal_dim),
            "reward": pa.float64(),
            "success": pa.bool_(),
        },
        metadata={METADATA_KEY: json.dumps(selection.describe())},
    )


def _rows(name: str, stored: StoredEpisode, model: GoalModel, schema: pa.Schema) -> pa.RecordBatch:
    import pyarrow as pa

    episode, length = stored.episode, len(stored.episode)
    columns: dict[str, Any] = {
        "run": [name] * length,
        "episode": np.full(length, stored.index),
        "tick": np.arange(length),
        "epoch": np.full(length, stored.epoch),
        "account": [stored.account] * length,
        "seed": np.full(length, stored.seed),
        "told_source": np.full(length, stored.policy_source),
        "ended": [stored.ended] * length,
        "seq": stored.seqs,
        "elapsed": stored.elapsed,
        "valid": episode.valid,
        "observation": episode.observations[:-1],
        "next_observation": episode.observations[1:],
        "action_requested": episode.requested_actions,
        "action_applied": episode.actions,
        "desired_goal": np.broadcast_to(episode.desired_goal, (length, model.goal_dim)),
        "achieved_goal": achieved_goals(stored, model),
        "reward": rewards(stored, model),
        "success": reached(stored, model),
    }
    arrays = [_column(columns[field.name], field.type) for field in schema]
    return pa.RecordBatch.from_arrays(arrays, schema=schema)


def _column(values: Any, kind: pa.DataType) -> pa.Array:
    import pyarrow as pa

    if isinstance(values, np.ndarray) and values.ndim == 2:
        flat: NDArray[np.float64] = np.ascontiguousarray(values, dtype=np.float64).reshape(-1)
        return pa.FixedSizeListArray.from_arrays(pa.array(flat), type=kind)
    return pa.array(values, kind)
