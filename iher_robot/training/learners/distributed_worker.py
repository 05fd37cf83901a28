"""A process of ``torchrun`` that only learns: it has no robot, no folder, and says nothing."""

from __future__ import annotations

import signal

import torch

from iher_robot.config.device import pick_device
from iher_robot.config.run import RunConfig
from iher_robot.errors import UserError
from iher_robot.rollout.simulators.messages import unpack_episodes
from iher_robot.training.learners.messages import begin_learner, weights_number
from iher_robot.training.learners.process_group import PeerGroup
from iher_robot.training.learners.torchrun import TorchrunRank


def main(place: TorchrunRank) -> None:
    """Learn what the first process learns, as its peer; it ends this one.

    Args:
        place: Which process this is.

    Raises:
        UserError: A setting that this machine cannot meet.
    """
    # While the first is waited for, torchrun ends this one, at once.
    _on_interrupts(signal.SIG_DFL)
    with PeerGroup(place) as group:
        group.join()
        _on_interrupts(signal.SIG_IGN)  # the first, which gets one too, ends this process
        begin = group.receive()
        config = RunConfig.model_validate_json(begin["config"])
        _require_device(config, place)
        learner = begin_learner(begin, config, group.receive, group)
        while True:
            learner.add_real(unpack_episodes(group.receive()["episodes"]))
            try:
                learner.learn()
            except FloatingPointError:
                group.wait_for_end()  # as in all processes; the first one says so
                raise
            group.agree_on(weights_number(learner))


def _require_device(config: RunConfig, place: TorchrunRank) -> None:
    gpus = torch.cuda.device_count()
    if pick_device(config.device).type == "cuda" and place.local_rank >= gpus:
        raise UserError(
            f"process {place.rank} of the {place.world_size} that learn together has no GPU: this "
            f"machine has {gpus}; start no more processes on it, or give --device cpu"
        )


def _on_interrupts(action: signal.Handlers) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, action)
