"""Parameters in one tensor: the module is equivalent, and its parameters are views."""

from __future__ import annotations

import copy

import pytest
import torch

from iher_robot.learning.networks.flat_parameters import FlatParameters
from iher_robot.learning.networks.mlp import mlp
from tests.learning.fakes import generator


def inputs() -> torch.Tensor:
    return torch.randn(20, 3, generator=generator(9))


def test_a_module_computes_as_before_and_its_parameters_are_views() -> None:
    module = mlp(3, (5, 7), 2, generator(), layer_norm=True)
    before = module(inputs())
    names = list(module.state_dict())
    flat = FlatParameters(module)
    assert torch.equal(module(inputs()), before)
    assert list(module.state_dict()) == names
    with torch.no_grad():
        flat.values.zero_()
    assert torch.equal(module(inputs()), torch.zeros(20, 2))


def test_loaded_weights_arrive_in_the_flat_tensor() -> None:
    module, other = mlp(3, (5,), 2, generator(1)), mlp(3, (5,), 2, generator(2))
    flat = FlatParameters(module)
    module.load_state_dict(other.state_dict())
    assert torch.equal(flat.values, FlatParameters(other).values)
    assert torch.equal(module(inputs()), other(inputs()))


def test_an_optimiser_of_the_flat_tensor_equals_one_of_the_parameters() -> None:
    module = mlp(3, (5, 7), 2, generator(), layer_norm=True)
    plain = copy.deepcopy(module)
    flat = FlatParameters(module)
    fast = torch.optim.Adam([flat.values], lr=1e-2, fused=True)
    slow = torch.optim.Adam(plain.parameters(), lr=1e-2, fused=True)
    for step in range(10):
        rows = inputs() + step
        flat.clear_gradients()
        for half in rows.split(10):  # what is added up is the gradient of the sum
            flat.add_gradients(module(half).square().sum())
        fast.step()
        slow.zero_grad()
        plain(rows).square().sum().backward()
        slow.step()
    torch.testing.assert_close(module(inputs()), plain(inputs()))


def test_gradients_reach_no_other_module() -> None:
    first, second = mlp(3, (5,), 3, generator(1)), mlp(3, (5,), 1, generator(2))
    below, above = FlatParameters(first), FlatParameters(second)
    below.add_gradients(second(first(inputs())).mean())
    assert below.values.grad is not None
    assert above.values.grad is not None
    assert below.values.grad.abs().max() > 0
    assert above.values.grad.abs().max() == 0


@pytest.mark.parametrize("share", [0.3, torch.tensor(0.3)])
def test_one_module_moves_towards_another_by_a_share(share: float | torch.Tensor) -> None:
    one, other = mlp(3, (5,), 2, generator(1)), mlp(3, (5,), 2, generator(2))
    pairs = zip(one.parameters(), other.parameters(), strict=True)
    expected = [torch.lerp(a.detach(), b.detach(), 0.3) for a, b in pairs]
    FlatParameters(one).move_towards(FlatParameters(other), share)
    for parameter, wanted in zip(one.parameters(), expected, strict=True):
        torch.testing.assert_close(parameter.detach(), wanted)
