"""Peer process of a distributed learner: no robot, no run folder, no output."""

from __future__ import annotations

import signal

import torch

from iher_robot.config.device import pick_device
from iher_robot.config.run import RunConfig
from iher_robot.errors import UserError
from iher_robot.rollout.simulators.messages import unpack_episodes
from iher_robot.training.learners.messages import begin_learner, weights_checksum
from iher_robot.training.learners.process_group import PeerGroup
from iher_robot.training.learners.torchrun import TorchrunRank


def main(rank: TorchrunRank) -> None:
    """Learn as a peer of the first process until that ends this one.

    Args:
        rank: Rank of this process.

    Raises:
        UserError: A setting that this machine cannot meet.
    """
    # Until the group has joined, torchrun ends this process at once.
    _on_interrupts(signal.SIG_DFL)
    with PeerGroup(rank) as group:
        group.join()
        _on_interrupts(signal.SIG_IGN)  # the first, which gets one too, ends this process
        begin = group.receive()
        config = RunConfig.model_validate_json(begin["config"])
        _require_device(config, rank)
        learner = begin_learner(begin, config, group.receive, group)
        while True:
            learner.add_real(unpack_episodes(group.receive()["episodes"]))
            try:
                learner.learn()
            except FloatingPointError:
                group.wait_for_end()  # as in all processes; the first one says so
                raise
            group.agree_on(weights_checksum(learner))


def _require_device(config: RunConfig, rank: TorchrunRank) -> None:
    gpus = torch.cuda.device_count()
    if pick_device(config.device).type == "cuda" and rank.local_rank >= gpus:
        raise UserError(
            f"process {rank.rank} of the {rank.world_size} that learn together has no GPU: this "
            f"machine has {gpus}; start no more processes on it, or give --device cpu"
        )


def _on_interrupts(action: signal.Handlers) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, action)
