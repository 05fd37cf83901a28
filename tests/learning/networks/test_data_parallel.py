"""Data-parallel learners, here in threads of one process."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
import torch

from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.learner import Learner
from iher_robot.learning.networks.data_parallel import (
    ALONE,
    Peers,
    local_rows,
)
from iher_robot.learning.transitions import Transitions
from tests.learning.point_mass import PointMassGoals
from tests.learning.small_learner import new, quick, real

ALL_PARTS: dict[str, dict[str, Any]] = {
    "contact": {"enabled": True, "hidden": (16, 16)},
    "ddpg": {"critics": 3, "target_subset": 2, "layer_norm": True, "actor_period": 2},
}
TOLERANCE = 1e-5
"""Gradients move weights by 0.01 to 0.1 here; rounding was found to move them by 1e-7."""


class ThreadPeers:
    """Peers in threads, which exchange tensors in a list."""

    def __init__(self, rank: int, tensors: list[torch.Tensor], barrier: threading.Barrier) -> None:
        self.rank = rank
        self.world_size = len(tensors)
        self._tensors = tensors
        self._barrier = barrier

    def average(self, tensor: torch.Tensor, /) -> None:
        self._tensors[self.rank] = tensor.clone()
        self._barrier.wait(30.0)
        tensor.copy_(torch.stack(self._tensors).mean(0))
        self._barrier.wait(30.0)


def run_as_peers(count: int, work: Callable[[Peers], Any]) -> list[Any]:
    """Run work as several peers at once."""
    tensors, barrier = [torch.empty(0)] * count, threading.Barrier(count)
    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(work, (ThreadPeers(rank, tensors, barrier) for rank in range(count))))


def weights(learner: Learner) -> Iterator[tuple[str, torch.Tensor]]:
    """Every trained parameter, by name."""
    parts: dict[str, Any] = {"actor": learner.policy.actor, "critics": learner.ddpg.critics}
    parts["dynamics"] = learner.ensemble.members
    if learner.contact is not None:
        parts["contact actor"] = learner.contact.policy.actor
        parts["contact critic"] = learner.contact.ddpg.critics
    for name, module in parts.items():
        for parameter in module.parameters():
            yield name, parameter.detach()


def learned(config: LearnerConfig, peers: Peers, epochs: int = 2) -> tuple[Learner, dict[str, Any]]:
    learner = new(config, contact_model=PointMassGoals(), peers=peers)
    metrics: dict[str, Any] = {}
    for epoch in range(1, epochs + 1):
        learner.add_real(real(epoch))
        metrics = learner.learn()
    return learner, metrics


@pytest.mark.parametrize("count", [2, 5])
def test_several_learners_equal_one_with_the_whole_batch(count: int) -> None:
    config = quick(**ALL_PARTS, dynamics={"hidden": (32, 32), "batch_size": 60})
    before = dict(enumerate(weights(new(config, contact_model=PointMassGoals()))))
    alone, its_metrics = learned(config, ALONE)
    peers = run_as_peers(count, lambda each: learned(config, each))
    for at, (name, its) in enumerate(weights(alone)):
        ours = [list(weights(learner))[at][1] for learner, _ in peers]
        assert all(torch.equal(each, ours[0]) for each in ours), name
        moved = float((its - before[at][1]).abs().max())
        assert moved > 100 * TOLERANCE, (name, moved)
        torch.testing.assert_close(ours[0], its, rtol=0.0, atol=TOLERANCE)
    for name, value in peers[0][1].items():
        if name != "updates_per_second":
            assert value == pytest.approx(its_metrics[name], rel=1e-3, abs=1e-6), name


def test_the_shards_of_a_batch_are_its_rows() -> None:
    rows = torch.arange(24.0)
    block = Transitions(*[rows + 100 * field for field in range(7)])
    shares = run_as_peers(3, lambda peers: block.shard(2, peers))
    for first, last in ((0, 12), (12, 24)):
        found = torch.cat([share.observation.chunk(2)[first // 12] for share in shares])
        assert sorted(found.tolist()) == rows[first:last].tolist()
    for share in shares:
        assert torch.equal(share.source, share.observation + 600)
    assert block.shard(2, ALONE) is block
    assert local_rows(rows, 2, ALONE) is rows
