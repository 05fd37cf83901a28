"""Updates on a device: the host never waits for it, and CUDA graphs give the same result.

Waiting for the device is detected on a CPU as well, so that most of this runs without a GPU.
"""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from iher_robot.learning.learner import Learner
from iher_robot.learning.networks.cuda_graphs import Tensors, Work
from iher_robot.learning.transitions import BLOCK
from tests.learning.fakes import FarAwaySymmetry, same
from tests.learning.point_mass import SHAPES, PointMassGoals
from tests.learning.small_learner import new, quick, real

SETTINGS: dict[str, dict[str, Any]] = {
    "paper": {},
    "default": {
        "ddpg": {
            "critics": 2,
            "target_subset": 2,
            "layer_norm": True,
            "actor_period": 2,
            "target_update": "update",
            "policy_average": 0.01,
        },
        "replay": {"still_weight": 0.1, "actions": "between"},
        "symmetry": {"enabled": True},
        "contact": {"enabled": True},
    },
}
DECLARED: dict[str, dict[str, Any]] = {
    "paper": {},
    "default": {"symmetry": FarAwaySymmetry(), "contact_model": PointMassGoals()},
}


class NoSynchronisation(TorchDispatchMode):
    """Refuses what makes the host wait for a GPU: values, and shapes that depend on values."""

    WAITS = ("_local_scalar_dense", "nonzero", "masked_select", "unique", "is_nonzero", "equal")

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = func.overloadpacket.__name__
        assert name not in self.WAITS, name
        if name in ("index", "index_put", "index_put_"):
            assert all(each is None or each.dtype != torch.bool for each in args[1]), name
        return func(*args, **(kwargs or {}))


def learner_of(name: str) -> Learner:
    settings = SETTINGS[name] | {"imagination": {"share": 0.5}}
    learner = new(quick(**settings), **DECLARED[name])
    learner.add_real(real(1))
    learner.learn()
    return learner


@pytest.mark.parametrize("name", SETTINGS)
def test_a_block_of_updates_never_waits_for_the_device(name: str) -> None:
    learner = learner_of(name)
    before = learner.ddpg.state_dict()["critics"]
    with NoSynchronisation():  # type: ignore[no-untyped-call]
        learner.ddpg.update_block(learner.sample_block(BLOCK), BLOCK)
    after = learner.ddpg.state_dict()["critics"]
    assert any(not torch.equal(before[key], after[key]) for key in before)


def test_waiting_for_the_device_is_detected() -> None:
    values = torch.arange(3.0)
    for waits in (lambda: float(values[0]), lambda: values[values > 1], lambda: bool(values.any())):
        with pytest.raises(AssertionError), NoSynchronisation():  # type: ignore[no-untyped-call]
            waits()


@pytest.mark.parametrize("name", SETTINGS)
def test_a_block_of_updates_equals_single_updates(name: str) -> None:
    together, apart = learner_of(name), learner_of(name)
    count = 7
    block = together.sample_block(count)
    wanted = [apart.ddpg.update(batch) for batch in block.split(count)]
    report = together.ddpg.update_block(block, count)
    for key in ("critics", "target_critics", "target_actor", "mean_actor"):
        found, alone = together.ddpg.state_dict()[key], apart.ddpg.state_dict()[key]
        for each in found:
            torch.testing.assert_close(found[each], alone[each])
    for key in report:
        values = torch.cat([one[key] for one in wanted if key in one])
        torch.testing.assert_close(report[key], values, rtol=1e-4, atol=1e-5)


class EagerGraphs:
    """CUDA graphs without a GPU: run the work on copies of its inputs."""

    def __init__(self) -> None:
        self.phases: set[int] = set()

    def run(self, kind: tuple[int, int], inputs: Tensors, work: Work) -> dict[str, torch.Tensor]:
        self.phases.add(kind[1])
        return work(tuple(value.clone() for value in inputs))


@pytest.mark.parametrize("name", SETTINGS)
def test_the_work_that_graphs_capture_is_that_of_an_update(name: str) -> None:
    plain, captured = learner_of(name), learner_of(name)
    graphs = EagerGraphs()
    captured.ddpg._graphs = graphs  # type: ignore[assignment]
    for learner in (plain, captured):
        learner.add_real(real(2))
        learner.learn()
    assert same(plain.ddpg.state_dict(), captured.ddpg.state_dict())
    assert same(plain.policy.snapshot(), captured.policy.snapshot())
    assert graphs.phases == set(range(captured.config.ddpg.actor_period))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
@pytest.mark.parametrize("name", SETTINGS)
def test_replayed_graphs_equal_launched_kernels(name: str) -> None:
    learned = []
    for graphs in (False, True):
        config = quick(**SETTINGS[name]).model_copy(update={"cuda_graphs": graphs})
        learner = Learner(
            SHAPES,
            PointMassGoals(),
            config,
            seed=0,
            device=torch.device("cuda"),
            **DECLARED[name],
        )
        for epoch in (1, 2, 3):
            learner.add_real(real(epoch))
            learner.learn()
        learned.append(learner.ddpg.state_dict()["critics"])
    for key, expected in learned[0].items():
        torch.testing.assert_close(learned[1][key], expected, rtol=1e-3, atol=1e-4)
