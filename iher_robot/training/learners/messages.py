"""Start-up messages for a remote learner, and the learner made from them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from typing import Any

import torch

from drivers.remote.driver import read_spec
from iher_robot.config.device import pick_device, prepare_torch
from iher_robot.config.run import RunConfig
from iher_robot.learning.learner import Learner
from iher_robot.learning.networks.data_parallel import ALONE, Peers
from iher_robot.rollout.simulators.messages import Message, pack_episodes, unpack_episodes
from iher_robot.training.recovery import Restored
from iher_robot.training.setup import TrainingSetup, make_learner
from tasks import make_task


def begin_messages(setup: TrainingSetup, restored: Restored) -> Iterator[Message]:
    """Describe the learner of a run.

    Args:
        setup: Robot and settings.
        restored: State of the run so far.

    Yields:
        The messages, one at a time: all real episodes of a run need not fit in one.
    """
    yield {
        "kind": "begin",
        "config": setup.config.model_dump_json(),
        "spec": setup.env.robot_spec.to_dict(),
        "simulated": setup.simulator is not None,
        "state": restored.learner,
        "epochs": len(restored.by_epoch),
    }
    for episodes in restored.by_epoch:
        yield {"kind": "epoch", "episodes": pack_episodes(episodes)}


def begin_learner(
    begin: Message, config: RunConfig, receive: Callable[[], Message], peers: Peers = ALONE
) -> Learner:
    """Make the learner that ``begin_messages`` describe.

    Args:
        begin: The first message.
        config: Settings of the run, from that message.
        receive: Waits for the next message.
        peers: Learners that share every batch with it.

    Returns:
        The learner in the state of the run.

    Raises:
        UserError: A setting that this machine cannot meet.
    """
    prepare_torch(config)
    task = make_task(config.task).bind(read_spec(begin["spec"]))
    learner = make_learner(config, task, pick_device(config.device), peers)
    epochs = (unpack_episodes(receive()["episodes"]) for _ in range(begin["epochs"]))
    if begin["state"] is not None:
        learner.load_state_dict(begin["state"], epochs)
    return learner


def weights_checksum(learner: Learner) -> int:
    """Checksum of networks, targets and optimisers, from 0 to 2**63 - 1."""
    parts: list[Any] = [learner.policy.snapshot()["actor"], learner.ddpg.state_dict()]
    parts.append(learner.ensemble.state_dict()["members"])
    if learner.contact is not None:
        contact = learner.contact
        parts += [contact.policy.snapshot()["actor"], contact.ddpg.state_dict()]
    digest = hashlib.sha256()
    for tensor in _tensors(parts):
        digest.update(tensor.cpu().numpy().tobytes())
    return int.from_bytes(digest.digest()[:8], "big") >> 1


def _tensors(node: Any) -> Iterator[torch.Tensor]:
    if isinstance(node, torch.Tensor):
        yield node
    elif isinstance(node, dict | list):
        for part in node.values() if isinstance(node, dict) else node:
            yield from _tensors(part)
