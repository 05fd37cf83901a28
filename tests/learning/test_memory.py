"""Memory of a learner: it is bounded, and matrix products have few different shapes."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from iher_robot.learning.diagnostics import diagnose
from iher_robot.learning.episode import Episode
from iher_robot.learning.learner import Learner
from iher_robot.learning.networks.mlp import LARGEST_BLOCK
from iher_robot.learning.replay import EpisodeReplay
from tests.learning.fakes import CPU, FarAwaySymmetry
from tests.learning.point_mass import SHAPES, PointMassGoals
from tests.learning.small_learner import HER, new, quick, real

TICKS = SHAPES.episode_ticks
CONTACT: dict[str, Any] = {"contact": {"enabled": True}, "symmetry": {"enabled": True}}
KINDS: dict[str, dict[str, Any]] = {
    "whole episodes": {"replay": {"actions": "between"}},
    "kept data": {"imagination": {"regenerate": False}},
    "branches": {"imagination": {"branch_ticks": 2, "keep": 0.5}},
    "no imagination": {**HER, **CONTACT},
}


def held_bytes() -> int:
    """Bytes of all referenced tensors; views of one storage count once."""
    gc.collect()
    tensors = [each for each in gc.get_objects() if issubclass(type(each), torch.Tensor)]
    storages = {s.data_ptr(): s.nbytes() for s in (t.untyped_storage() for t in tensors)}
    return sum(storages.values())


def ragged(epoch: int) -> list[Episode]:
    """Episodes with invalid ticks, with another number of transitions in each epoch."""
    rng = np.random.default_rng(epoch)
    return [replace(e, valid=rng.random(TICKS) < 0.8) for e in real(epoch, 3 + epoch % 4)]


def epoch_of(learner: Learner, episodes: list[Episode]) -> None:
    learner.add_real(episodes)
    learner.learn()
    diagnose(learner, real(0))
    learner.state_dict()


@pytest.fixture(autouse=True)
def only_new_objects() -> Iterator[None]:
    """Limit `gc` to the objects of a test, without those of every imported module."""
    gc.collect()
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.mark.parametrize("kind", KINDS)
def test_memory_is_constant_once_the_replays_are_full(kind: str) -> None:
    sections = dict(KINDS[kind])
    sections["replay"] = sections.get("replay", {}) | {"capacity": 10 * TICKS}
    learner = new(quick(**sections), symmetry=FarAwaySymmetry(), contact_model=PointMassGoals())
    held = []
    for epoch in range(1, 9):
        epoch_of(learner, ragged(epoch))
        held.append(held_bytes())
    assert learner.real.replay.num_episodes == 10
    assert len(set(held[3:])) == 1, held


@pytest.mark.parametrize("between", [False, True])
@pytest.mark.parametrize("capacity", [TICKS, 1_000, 12_345])
def test_the_bytes_of_a_replay_depend_on_its_capacity_only(capacity: int, between: bool) -> None:
    before = held_bytes()
    replay = EpisodeReplay(SHAPES, capacity=capacity, source=0, device=CPU, between=between)
    obs, action, goal = SHAPES.obs_dim, SHAPES.action_dim, SHAPES.goal_dim
    numbers = (TICKS + 1) * obs + TICKS * action * (2 if between else 1) + goal + TICKS
    expected = capacity // TICKS * (4 * numbers + 3 * 8)  # and length, epoch and weight
    assert held_bytes() - before == expected
    for epoch in range(3):
        for count in (1, 7):
            replay.add(
                torch.zeros(count, TICKS + 1, obs),
                torch.zeros(count, TICKS, action),
                torch.zeros(count, goal),
                epoch=epoch,
            )
    assert held_bytes() - before == expected


@contextmanager
def rows_of_products() -> Iterator[set[int]]:
    """Numbers of rows that linear layers receive inside the context."""
    seen: set[int] = set()

    def note(module: nn.Module, args: tuple[Any, ...]) -> None:
        if isinstance(module, nn.Linear):
            seen.add(len(args[0]))

    handle = nn.modules.module.register_module_forward_pre_hook(note)
    try:
        yield seen
    finally:
        handle.remove()


@pytest.mark.parametrize("kind", KINDS)
def test_matrix_products_have_the_rows_of_a_batch_or_of_a_block(kind: str) -> None:
    config = quick(schedule={"imaginary_rollouts": 3}, **KINDS[kind])
    learner = new(config, symmetry=FarAwaySymmetry(), contact_model=PointMassGoals())
    with rows_of_products() as seen:
        for epoch in range(1, 7):
            epoch_of(learner, ragged(epoch))
    blocks = {2**power for power in range(LARGEST_BLOCK.bit_length())}
    assert seen <= blocks | {config.ddpg.batch_size, config.dynamics.batch_size}
    assert config.ddpg.batch_size in seen


def test_branches_keep_no_copy_of_a_policy() -> None:
    learner = new(quick(**KINDS["branches"]))
    learner.add_real(real(1))
    learner.learn()
    assert learner.cycle >= 2 * learner.config.schedule.policy_copy_cycles
    assert learner.state_dict()["imagined"]["policy_copies"] == []


def test_episodes_are_restored_one_epoch_at_a_time() -> None:
    learner, resumed = new(quick()), new(quick())
    epochs = range(1, 7)
    for epoch in epochs:
        learner.add_real(real(epoch))
    alive: list[int] = []

    def read() -> Iterator[Iterator[Episode]]:
        for epoch in epochs:
            episodes = real(epoch)
            alive.append(sum(type(each) is Episode for each in gc.get_objects()))
            yield iter(episodes)

    resumed.load_state_dict(learner.state_dict(), read())
    assert resumed.real.replay.num_transitions == learner.real.replay.num_transitions
    assert resumed.real.replay.newest_epoch == 6
    assert max(alive) - alive[0] <= len(real(1))
