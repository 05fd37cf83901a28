"""Read-only access to the real data of a run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any

from drivers.closing import Closing
from iher_robot.config.run import RunConfig, read_config
from iher_robot.errors import UserError
from iher_robot.storage.accounts import Account, read_accounts
from iher_robot.storage.episode import StoredEpisode, read_episode
from iher_robot.storage.episode_reader import EpisodeReader
from iher_robot.storage.files.atomic import read_file
from iher_robot.storage.interface import read_interface
from iher_robot.storage.provenance import read_provenance
from iher_robot.storage.run_directory import RunDirectory
from tasks import GoalTask, make_task


@dataclass(frozen=True)
class RobotOfRun:
    """The robot of a run, as the run recorded it.

    Attributes:
        spec: The robot's description, JSON values.
        interface_digest: Digest of what must match between a policy and a robot.
        body_digest: Digest of what distinguishes robots with the same interface.
    """

    spec: Mapping[str, Any]
    interface_digest: str
    body_digest: str

    @property
    def control_period_s(self) -> float:
        """Length of a control tick."""
        return float(self.spec["control_period_s"])


class RunData(Closing):
    """Data in the folder of a run; each part is read on first access.

    While the run is in progress, episodes are those stored at that moment.

    Args:
        path: The run's folder.

    Raises:
        UserError: There is no run. A part that is missing or damaged raises it on access.
    """

    def __init__(self, path: Path) -> None:
        if not is_run(path):
            raise UserError(
                f"there is no run at {path}; give a folder that iher-robot train made, see "
                "iher-robot data ls"
            )
        self.path = path
        self.directory = RunDirectory(path)

    @cached_property
    def config(self) -> RunConfig:
        """Settings of the run."""
        return read_config(self.directory.config_path)

    @cached_property
    def task(self) -> GoalTask:
        """The task, not bound to a robot."""
        return make_task(self.config.task)

    @cached_property
    def provenance(self) -> Mapping[str, Any]:
        """Command, versions, commit and machine; empty before the run has begun."""
        path = self.directory.provenance_path
        return read_provenance(path) if path.exists() else {}

    @cached_property
    def spent_ticks(self) -> Mapping[Account, int]:
        """Ticks by account."""
        return read_accounts(self.directory.ledger_path).spent

    @cached_property
    def robot(self) -> RobotOfRun | None:
        """The robot; None before the run has begun."""
        directory = self.directory.episodes_path
        if not directory.is_dir():
            return None
        found, layout = read_interface(directory), self.task.layout
        if (found["task"], found["layout_digest"]) != (self.task.name, layout.digest()):
            raise UserError(
                f"the data in {directory} are of task {found['task']!r} and layout "
                f"{found['layout_digest']}, and {self.directory.config_path} is of "
                f"{self.task.name!r} and {layout.digest()}; restore the files that belong together"
            )
        return RobotOfRun(found["spec"], found["interface_digest"], found["body_digest"])

    @property
    def last_change(self) -> datetime:
        """Time of the last write, in local time."""
        folders = [self.path, self.directory.episodes_path]
        files = [file for folder in folders if folder.is_dir() for file in folder.iterdir()]
        newest = max((file.stat().st_mtime for file in [self.path, *files]), default=0.0)
        return datetime.fromtimestamp(newest).astimezone()

    def __len__(self) -> int:
        """Number of stored episodes."""
        return 0 if self._reader is None else len(self._reader)

    def load(self, index: int) -> StoredEpisode:
        """Read an episode.

        Args:
            index: Index in the store, from 0.

        Raises:
            UserError: There is no such episode, it is damaged, or it is of another task.
        """
        count = len(self)
        if self._reader is None or not 0 <= index < count:
            allowed = f"0 to {count - 1}" if count else "none, nothing is stored yet"
            raise UserError(f"episode is {index}, allowed in {self.path}: {allowed}")
        stored = self._reader.load(index)
        self.require_own_task(stored)
        return stored

    def episodes(self) -> Iterator[StoredEpisode]:
        """Read all episodes, oldest first."""
        return (self.load(index) for index in range(len(self)))

    def require_own_task(self, stored: StoredEpisode) -> None:
        """Check that observations and goals of an episode have the shapes of the run's task.

        Raises:
            UserError: They have others.
        """
        shapes = stored.episode.observations.shape[1:], stored.episode.desired_goal.shape
        expected = (self.task.layout.obs_dim,), (self.task.goal_dim,)
        if shapes != expected:
            raise UserError(
                f"episode {stored.index} of {self.path} has observations and a goal of shapes "
                f"{shapes}, those of task {self.task.name!r} are {expected}; restore the run's own "
                "config.yaml or episodes"
            )

    def close(self) -> None:
        """Release the store; closing twice does nothing."""
        if "_reader" in vars(self) and self._reader is not None:
            self._reader.close()

    @cached_property
    def _reader(self) -> EpisodeReader | None:
        path = self.directory.episodes_path
        return EpisodeReader(path) if path.is_dir() else None


def is_run(path: Path) -> bool:
    """Whether a folder holds a run, damaged or not."""
    directory = RunDirectory(path)
    return directory.config_path.is_file() or directory.episodes_path.is_dir()


def examine_store(directory: Path) -> Iterator[StoredEpisode | UserError]:
    """Read every episode of a folder, or the error where one cannot be read.

    Args:
        directory: Folder of episodes; a missing one counts as empty.
    """
    if not directory.is_dir():
        return
    try:
        reader = EpisodeReader(directory)
    except UserError as error:
        yield error
        paths = {_number(path): path for path in directory.glob("episode-*.npz")}
        yield from _each(
            sorted(paths),
            lambda index: read_episode(
                paths[index], read_file(paths[index], "episode file"), index
            ),
        )
        return
    with reader:
        yield from _each(range(len(reader)), reader.load)


def _each(
    indices: Iterable[int], load: Callable[[int], StoredEpisode]
) -> Iterator[StoredEpisode | UserError]:
    for index in indices:
        try:
            yield load(index)
        except UserError as error:
            yield error


def _number(path: Path) -> int:
    digits = path.stem.removeprefix("episode-")
    return int(digits) if digits.isdecimal() else -1  # an index that no episode has
