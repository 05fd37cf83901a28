"""Settings that the task or the number of learners does not allow."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
import torch

from iher_robot.learning.learner import Learner
from iher_robot.learning.networks.data_parallel import require_equal_shards
from tests.learning.fakes import CPU
from tests.learning.point_mass import SHAPES, PointMassGoals
from tests.learning.small_learner import new, quick


@pytest.mark.parametrize(
    ("section", "message"),
    [("symmetry", "declares no symmetries"), ("contact", "declares no object")],
)
def test_what_the_task_does_not_declare_cannot_be_enabled(section: str, message: str) -> None:
    with pytest.raises(ValueError, match=rf"learner\.{section}\.enabled is true.*{message}"):
        new(quick(**{section: {"enabled": True}}))


@pytest.mark.parametrize("section", ["ddpg", "dynamics"])
def test_relative_inputs_need_entries_that_a_shift_changes(section: str) -> None:
    config = quick(**{section: {"inputs": "relative"}})
    with pytest.raises(ValueError, match=rf"learner\.{section}\.inputs is relative.*no entries"):
        new(config)
    shapes = dataclasses.replace(SHAPES, goal_entries=(0, 1), shifted_entries=(0, 1))
    Learner(shapes, PointMassGoals(), config, seed=0, device=CPU)


@dataclasses.dataclass(frozen=True)
class TwoLearners:
    """The first of two learners, which never communicate."""

    rank: int = 0
    world_size: int = 2

    def average(self, tensor: torch.Tensor, /) -> None:
        raise NotImplementedError


@pytest.mark.parametrize(("section", "size"), [("ddpg", 51), ("dynamics", 7)])
def test_batches_without_equal_shards_are_refused(section: str, size: int) -> None:
    config = quick(**{section: {"batch_size": size}})
    named = f"learner.schedule.workers x learner.{section}.batch_size is {size}"
    with pytest.raises(ValueError, match=f"{named}, which 2 processes cannot share equally"):
        new(config, peers=TwoLearners())
    new(config)


def test_batches_that_are_not_used_need_no_equal_shards() -> None:
    settings: dict[str, Any] = {"dynamics": {"batch_size": 7}, "imagination": {"enabled": False}}
    new(quick(**settings), peers=TwoLearners())
    require_equal_shards("a batch", 12, TwoLearners())
