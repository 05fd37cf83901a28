"""Moments of a kill: draw one at random, and wait for it."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import dataclass
from enum import StrEnum
from fnmatch import fnmatch
from pathlib import Path

import numpy as np

from tests.faults.folder_watch import FolderWatch
from tests.faults.host_log import HostLog
from tests.faults.learner import Learner

STARTUP_S = 8.0
EPOCH_S = 5.5
"""Approximate time to the first tick, and for each epoch."""
EPISODE_TICKS = 50
_POLL_S = 0.005
SLOW_DISK, JUMPING_CLOCK = "slow_disk", "jumping_clock"


class Kind(StrEnum):
    """Kind of a kill."""

    ANY_TIME = "any time"
    EPISODE = "within an episode"
    EVALUATION = "within an evaluation on the robot"
    CHECKPOINT = "while a checkpoint is written"
    SEALING = "while an episode is sealed"
    FULL_DISK = "on a full disk"
    JUMPING_CLOCK = "with a jumping clock"


@dataclass(frozen=True)
class Moment:
    """Moment of a kill.

    Attributes:
        kind: Kind of the kill.
        number: Which of several occurrences, from 1.
        delay_s: Delay after the occurrence.
        patience_s: How long a learner may run on a full disk before it is killed.
        world: Library to preload into the learner, empty for none.
        world_seed: Seed of the library.
    """

    kind: Kind
    number: int
    delay_s: float
    patience_s: float = 60.0
    world: str = ""
    world_seed: int = 0


def draw_moment(  # noqa: PLR0911 - one for each kind
    kind: Kind, rng: np.random.Generator, remaining_ticks: int
) -> Moment:
    """Draw a moment.

    Args:
        kind: Kind of the kill.
        rng: Random generator.
        remaining_ticks: Rest of the run's budget, which limits the life of a process.
    """
    life_s = STARTUP_S + EPOCH_S * max(1.0, remaining_ticks / EPISODE_TICKS)
    match kind:
        case Kind.EPISODE:
            return Moment(kind, int(rng.integers(1, 2 * EPISODE_TICKS)), rng.uniform(0.0, 0.08))
        case Kind.EVALUATION:
            return Moment(kind, int(rng.integers(1, EPISODE_TICKS)), rng.uniform(0.0, 0.08))
        case Kind.CHECKPOINT:
            return Moment(kind, int(rng.integers(1, 3)), rng.uniform(0.0, 0.07), world=SLOW_DISK)
        case Kind.SEALING:
            return Moment(kind, int(rng.integers(1, 4)), rng.uniform(0.0, 0.08), world=SLOW_DISK)
        case Kind.FULL_DISK:
            patience_s = 60.0 if rng.random() < 0.7 else rng.uniform(0.0, 4.0)
            return Moment(kind, 1, rng.uniform(STARTUP_S / 2, life_s), patience_s)
        case Kind.JUMPING_CLOCK:
            delay_s, seed = rng.uniform(STARTUP_S, life_s), int(rng.integers(2**31))
            return Moment(kind, 1, delay_s, world=JUMPING_CLOCK, world_seed=seed)
        case Kind.ANY_TIME:
            return Moment(kind, 1, rng.uniform(0.0, life_s))


class Scene:
    """A learner at work, its run's folder and the host's log."""

    def __init__(self, learner: Learner, folder: Path, log: HostLog) -> None:
        self._learner = learner
        self._folder = folder
        self._log = log

    def wait(self, moment: Moment) -> bool:
        """Wait for a moment.

        Returns:
            Whether it came before the learner ended.
        """
        match moment.kind:
            case Kind.EPISODE:
                came = self._wait_for_ticks(moment.number)
            case Kind.EVALUATION:
                came = self._wait_for_evaluation(moment.number)
            case Kind.CHECKPOINT:
                came = self._wait_for_file(".", ".checkpoint*.tmp", moment.number)
            case Kind.SEALING:
                came = self._wait_for_file("episodes", ".episode-*.tmp", moment.number)
            case _:
                came = True
        return came and self._pass(moment.delay_s)

    def _pass(self, seconds: float) -> bool:
        deadline = time.monotonic() + seconds
        while self._learner.runs and (left_s := deadline - time.monotonic()) > 0:
            time.sleep(min(left_s, 0.05))
        return self._learner.runs

    def _wait_for_ticks(self, number: int) -> bool:
        """Wait for a number of ticks with a command in force."""
        self._log.read()
        begun = len(self._log.ticks)
        while self._learner.runs:
            self._log.read()
            if sum(tick.commanded for tick in self._log.ticks[begun:]) >= number:
                return True
            time.sleep(_POLL_S)
        return False

    def _watch(self, stack: ExitStack, name: str) -> FolderWatch | None:
        folder = self._folder / name
        while self._learner.runs:
            if folder.is_dir():
                return stack.enter_context(FolderWatch(folder))
            time.sleep(_POLL_S)
        return None

    def _wait_for_file(self, folder: str, pattern: str, number: int) -> bool:
        with ExitStack() as stack:
            watch = self._watch(stack, folder)
            last = ""
            while watch is not None and self._learner.runs:
                for name in watch.wait(0.2):
                    if fnmatch(name, pattern):
                        # One file causes many events; another file's event separates two files.
                        number -= name != last
                    last = name
                if number <= 0:
                    return True
        return False

    def _wait_for_evaluation(self, number: int) -> bool:
        """Wait for ticks of an episode that follows another one within the same epoch."""
        with ExitStack() as stack:
            run, episodes = self._watch(stack, "."), self._watch(stack, "episodes")
            sealed = armed = evaluates = False
            while run is not None and episodes is not None and self._learner.runs:
                if any(name.startswith("metrics") for name in run.wait(0.0)):
                    sealed = False
                if any(fnmatch(name, "episode-*") for name in episodes.wait(_POLL_S)):
                    sealed = True
                for tick in self._log.read():
                    evaluates = tick.armed and (evaluates or (sealed and not armed))
                    armed = tick.armed
                    number -= evaluates and tick.commanded
                if number <= 0:
                    return True
        return False
