"""The learner of the process that has the robot, where ``torchrun`` started several."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType

from iher_robot.errors import UserError
from iher_robot.learning.progress import Progress
from iher_robot.rollout.simulators.messages import pack_episodes
from iher_robot.training.epoch import EpochData, Learned
from iher_robot.training.learners.base import SyncLearner
from iher_robot.training.learners.messages import begin_messages, weights_number
from iher_robot.training.learners.process_group import PeerGone, PeerGroup
from iher_robot.training.recovery import Restored
from iher_robot.training.setup import TrainingSetup

_NEWS_S = 0.5


class DistributedLearner(SyncLearner):
    """Learns in this process and at the same time in others, while the robot is held.

    All of them are told everything that this one learns from, and share every batch.

    Args:
        cell: Robot, simulator and learner, whose peers are the group.
        group: The processes.
        run: Folder of the run, which can be resumed later.
        progress: Told how far each phase is.
    """

    def __init__(
        self, cell: TrainingSetup, group: PeerGroup, run: Path, progress: Progress
    ) -> None:
        super().__init__(cell, progress)
        self._group = group
        self._advice = f"continue with: iher-robot train --resume {shlex.quote(str(run))}"

    def begin(self, restored: Restored) -> None:
        """Meet the others, and take over the state of a stopped run, or begin as a new one."""
        try:
            self._group.join()
        except RuntimeError as error:
            raise UserError(
                f"the {self._group.world_size} processes of torchrun cannot reach each "
                f"other: {error}; on one machine give torchrun --standalone, on several name "
                "the network by GLOO_SOCKET_IFNAME"
            ) from error
        with self._gone_in_words():
            for message in begin_messages(self._cell, restored):
                self._group.send(message)
        super().begin(restored)

    def exchange(self, lesson: EpochData | None) -> Learned | None:
        """Learn an epoch together."""
        if lesson is None:
            return None
        with self._gone_in_words():
            self._group.send({"kind": "learn", "episodes": pack_episodes(lesson.episodes)})
            learned = super().exchange(lesson)
            if not self._group.agree_on(weights_number(self.learner)):
                raise UserError(
                    f"after epoch {lesson.epoch} the weights of the {self._group.world_size} "
                    "processes differ: their processors or versions of torch round differently; start "
                    f"all of them on machines of one kind; {self._advice}"
                )
        return learned

    def look(self) -> None:
        """Nothing changes between two episodes, but that another process may be gone."""
        gone = self._group.missed()
        if gone is not None:
            raise self._in_words(gone)

    def close(self) -> None:
        """End the others."""
        self._group.close()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # torchrun, too, has seen that a process is gone, and ends this one by a SIGTERM.
        gone = self._group.missed(_NEWS_S) if isinstance(error, KeyboardInterrupt) else None
        super().__exit__(kind, error, trace)
        if gone is not None:
            raise self._in_words(gone) from error

    @contextmanager
    def _gone_in_words(self) -> Iterator[None]:
        try:
            yield
        except PeerGone as gone:
            raise self._in_words(gone) from None

    def _in_words(self, gone: PeerGone) -> UserError:
        return UserError(
            f"process {gone.rank} of the {self._group.world_size} that learn together is gone; "
            f"nothing recorded is lost, {self._advice}"
        )
