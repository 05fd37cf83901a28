"""Distributed learner of the process with the robot; ``torchrun`` started the others."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType

from iher_robot.errors import UserError
from iher_robot.learning.progress import Progress
from iher_robot.rollout.simulators.messages import pack_episodes
from iher_robot.training.epoch import EpochData, LearnedEpoch
from iher_robot.training.learners.base import SyncLearner
from iher_robot.training.learners.messages import begin_messages, weights_checksum
from iher_robot.training.learners.process_group import PeerGone, PeerGroup
from iher_robot.training.recovery import Restored
from iher_robot.training.setup import TrainingSetup

_NEWS_S = 0.5


class DistributedLearner(SyncLearner):
    """Learns in this process and in its peers at the same time, while the robot is held.

    All processes get the same episodes and share every batch.

    Args:
        setup: Robot, simulator and learner, whose peers are the group.
        group: The process group.
        run: The run folder, for advice in messages.
        progress: Called with the progress of each phase.
    """

    def __init__(
        self, setup: TrainingSetup, group: PeerGroup, run: Path, progress: Progress
    ) -> None:
        super().__init__(setup, progress)
        self._group = group
        self._advice = f"continue with: iher-robot train --resume {shlex.quote(str(run))}"

    def begin(self, restored: Restored) -> None:
        """Join the process group, and start as a new run or from the state of a stopped one."""
        try:
            self._group.join()
        except RuntimeError as error:
            raise UserError(
                f"the {self._group.world_size} processes of torchrun cannot reach each "
                f"other: {error}; on one machine give torchrun --standalone, on several name "
                "the network by GLOO_SOCKET_IFNAME"
            ) from error
        with self._explain_lost_peer():
            for message in begin_messages(self._setup, restored):
                self._group.send(message)
        super().begin(restored)

    def exchange(self, epoch: EpochData | None) -> LearnedEpoch | None:
        """Learn an epoch in all processes."""
        if epoch is None:
            return None
        with self._explain_lost_peer():
            self._group.send({"kind": "learn", "episodes": pack_episodes(epoch.episodes)})
            learned = super().exchange(epoch)
            if not self._group.agree_on(weights_checksum(self.learner)):
                raise UserError(
                    f"after epoch {epoch.number} the weights of the {self._group.world_size} "
                    "processes differ: their processors or versions of torch round differently; "
                    f"start all of them on machines of one kind; {self._advice}"
                )
        return learned

    def look(self) -> None:
        """Check that no peer is gone; the policy does not change between two episodes."""
        gone = self._group.missed()
        if gone is not None:
            raise self._lost_peer_error(gone)

    def close(self) -> None:
        """End the peers."""
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
            raise self._lost_peer_error(gone) from error

    @contextmanager
    def _explain_lost_peer(self) -> Iterator[None]:
        try:
            yield
        except PeerGone as gone:
            raise self._lost_peer_error(gone) from None

    def _lost_peer_error(self, gone: PeerGone) -> UserError:
        return UserError(
            f"process {gone.rank} of the {self._group.world_size} that learn together is gone; "
            f"nothing recorded is lost, {self._advice}"
        )
