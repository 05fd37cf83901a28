"""Networks draw their weights from the generator that they are given."""

from __future__ import annotations

import torch

from iher_robot.learning.networks import mlp
from tests.learning.stand_ins import generator


def test_the_weights_come_from_the_generator_and_nothing_else() -> None:
    torch.manual_seed(1)
    first = mlp(4, (8, 8), 3, generator(5))
    torch.manual_seed(2)
    again, other = mlp(4, (8, 8), 3, generator(5)), mlp(4, (8, 8), 3, generator(6))
    for mine, same, different in zip(
        first.parameters(), again.parameters(), other.parameters(), strict=True
    ):
        assert torch.equal(mine, same)
        assert not torch.equal(mine, different)


def test_the_output_is_linear_and_the_hidden_layers_are_not() -> None:
    network = mlp(1, (64,), 1, generator())
    inputs = torch.linspace(-50, 50, 201).unsqueeze(-1)
    slopes = network(inputs).squeeze(-1).diff()
    assert (network(inputs) < 0).any()
    assert slopes.max() - slopes.min() > 1e-3
    flat = mlp(1, (), 1, generator())(inputs).squeeze(-1).diff()
    torch.testing.assert_close(flat, flat[:1].expand(200), rtol=1e-3, atol=1e-4)
