"""Process group of ``torchrun``: join, broadcast, average gradients, detect failures."""

from __future__ import annotations

import datetime
import os
import signal
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

import torch
from torch import distributed
from torch.distributed.rendezvous import rendezvous

from drivers.closing import Closing
from iher_robot.rollout.simulators.messages import Message, pack_message, unpack_message
from iher_robot.training.learners.torchrun import TorchrunRank

# Between two messages the robot moves, or a person fetches an object, for as long as it takes. A
# lost process is noticed at once, since its connection is closed; no timeout has to expire.
_TIMEOUT = datetime.timedelta(days=365)
_LOOK_S = 0.05
_END_S = 10.0
_ARRIVED = "iher_robot/arrived"


class PeerGone(RuntimeError):
    """Another process of the group has ended."""

    def __init__(self, rank: int) -> None:
        super().__init__(f"process {rank} is gone")
        self.rank = rank


class PeerGroup(Closing):
    """The group as seen by one of its processes; the learners' ``Peers``.

    When the first process is gone, the others exit at once and silently. Messages, and gradients on
    a CPU, travel by gloo; gradients on GPUs by NCCL, which was never tested.

    Args:
        rank: Rank of this process.
    """

    def __init__(self, rank: TorchrunRank) -> None:
        self.rank = rank.rank
        self.world_size = rank.world_size
        self._local_rank = rank.local_rank
        self._missed = threading.Event()
        self._missing = 0
        self._watches: list[threading.Thread] = []
        self._lifeline: distributed.ProcessGroup | None = None

    def join(self) -> None:
        """Join the group; the first process waits for all others, and they for it."""
        store, _, _ = next(rendezvous("env://", timeout=_TIMEOUT))
        arrived = [f"{_ARRIVED}/{rank}" for rank in range(1, self.world_size)]
        if self.rank:
            store.set(arrived[self.rank - 1], "")
        else:
            while not store.check(arrived):  # not one call, which no interrupt would end
                time.sleep(_LOOK_S)
        gpus = distributed.is_nccl_available() and torch.cuda.is_available()
        if gpus and self._local_rank < torch.cuda.device_count():
            torch.cuda.set_device(self._local_rank)
        distributed.init_process_group(
            "cpu:gloo,cuda:nccl" if gpus else "gloo",
            store=store,
            rank=self.rank,
            world_size=self.world_size,
            timeout=_TIMEOUT,
        )
        self._lifeline = distributed.new_group(backend="gloo", timeout=_TIMEOUT)
        # This group carries a single message: the end.
        for other in range(1, self.world_size) if self.rank == 0 else [0]:
            self._watch(other)

    def _watch(self, other: int) -> None:
        end = distributed.irecv(torch.zeros(1), other, group=self._lifeline)
        assert end is not None
        watch = threading.Thread(target=self._wait_for_end, args=(other, end), daemon=True)
        self._watches.append(watch)
        watch.start()

    def _wait_for_end(self, other: int, end: distributed.Work) -> None:
        with suppress(RuntimeError):  # the connection is closed
            end.wait()
        if self.rank:
            os._exit(0)
        if not self._missed.is_set():
            self._missing = other
            self._missed.set()

    def average(self, tensor: torch.Tensor, /) -> None:
        """Replace a tensor by the mean of all processes' in place.

        Raises:
            PeerGone: A process has ended; only in the first one.
        """
        with self._detect_failure():
            distributed.all_reduce(tensor)
        tensor /= self.world_size

    def agree_on(self, number: int) -> bool:
        """Check that a number from 0 to 2**63 - 1 is the same in all processes.

        Raises:
            PeerGone: A process has ended; only in the first one.
        """
        bounds = torch.tensor([number, -number])
        with self._detect_failure():
            distributed.all_reduce(bounds, distributed.ReduceOp.MAX)
        return bool(bounds[0] == -bounds[1])

    def send(self, message: Mapping[str, Any]) -> None:
        """Send a message from the first process to all others.

        Raises:
            PeerGone: A process has ended.
        """
        content = pack_message(message)
        with self._detect_failure():
            distributed.broadcast(torch.tensor([len(content)]), 0)
            distributed.broadcast(torch.frombuffer(content, dtype=torch.uint8), 0)

    def receive(self) -> Message:
        """Wait for the next message of the first process; its tensors are on the CPU."""
        size = torch.zeros(1, dtype=torch.long)
        with self._detect_failure():
            distributed.broadcast(size, 0)
            content = torch.empty(int(size), dtype=torch.uint8)
            distributed.broadcast(content, 0)
        return unpack_message(content.numpy().data)

    @contextmanager
    def _detect_failure(self) -> Iterator[None]:
        try:
            yield
        except RuntimeError:  # torch has no error class for a closed connection
            if self.rank:
                self.wait_for_end()
            elif (gone := self.missed(_END_S)) is not None:
                raise gone from None
            raise

    def missed(self, timeout_s: float = 0.0) -> PeerGone | None:
        """In the first process: the process that has ended; None if all are alive.

        Args:
            timeout_s: Longest time to wait for one to end.
        """
        if not self._missed.wait(timeout_s):
            return None
        # torchrun has noticed as well and is about to send SIGTERM; this process ends by itself.
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
        return PeerGone(self._missing)

    def wait_for_end(self) -> None:
        """In another process: wait until the first one ends this one."""
        for watch in self._watches:
            watch.join(_END_S)

    def close(self) -> None:
        """In the first process: end the others; they hold nothing that is not stored here."""
        if self._lifeline is None:
            return
        for other in range(1, self.world_size):
            with suppress(RuntimeError):  # it is gone
                distributed.send(torch.zeros(1), other, group=self._lifeline)
        for watch in self._watches:
            watch.join(_END_S)
        self._lifeline = None
        distributed.destroy_process_group()
