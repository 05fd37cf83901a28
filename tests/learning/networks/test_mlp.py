"""MLPs: initial weights, layer normalisation, blocks of rows, precision."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from iher_robot.learning.networks.mlp import LARGEST_BLOCK, block_sizes, forward, in_blocks, mlp
from tests.learning.fakes import generator


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


def test_layer_norm_is_optional_and_leaves_the_draws_as_they_are() -> None:
    def norms(network: nn.Module) -> list[nn.Module]:
        return [layer for layer in network.modules() if isinstance(layer, nn.LayerNorm)]

    plain, rng = mlp(4, (8, 16), 3, generator(5)), generator(5)
    normed = mlp(4, (8, 16), 3, rng, layer_norm=True)
    assert norms(plain) == []
    assert [layer.normalized_shape for layer in norms(normed)] == [(8,), (16,)]
    after, reference = torch.rand(3, generator=rng), generator(5)
    mlp(4, (8, 16), 3, reference)
    assert torch.equal(torch.rand(3, generator=reference), after)
    drawn = [
        p for layer in normed.modules() if isinstance(layer, nn.Linear) for p in layer.parameters()
    ]
    for mine, theirs in zip(drawn, plain.parameters(), strict=True):
        assert torch.equal(mine, theirs)


def test_the_input_of_a_relu_after_layer_norm_has_mean_zero_and_variance_one() -> None:
    network = mlp(4, (64, 64), 3, generator(), layer_norm=True)
    seen: list[torch.Tensor] = []
    for layer in network.modules():
        if isinstance(layer, nn.ReLU):
            layer.register_forward_pre_hook(lambda _, args: seen.append(args[0].clone()))
    network(100 * torch.randn(20, 4, generator=generator()))
    assert len(seen) == 2
    for values in seen:
        torch.testing.assert_close(values.mean(-1), torch.zeros(20), atol=1e-4, rtol=0)
        torch.testing.assert_close(values.var(-1, correction=0), torch.ones(20), atol=1e-2, rtol=0)


@pytest.mark.parametrize("rows", [0, 1, 3, 64, 65, 100, 500, 4000, 2 * LARGEST_BLOCK + 77])
def test_rows_in_blocks_equal_all_rows_at_once(rows: int) -> None:
    network = mlp(4, (16, 16), 3, generator(), layer_norm=True)
    inputs = torch.randn(rows, 4, generator=generator())
    seen: list[int] = []
    handle = network.register_forward_pre_hook(lambda _, args: seen.append(len(args[0])))
    outputs = in_blocks(network, inputs)
    handle.remove()
    assert outputs.shape == (rows, 3)
    torch.testing.assert_close(outputs, network(inputs))
    assert seen == (block_sizes(rows) or [0])


def test_blocks_have_few_sizes_and_little_padding() -> None:
    sizes: set[int] = set()
    for rows in range(1, 3 * LARGEST_BLOCK):
        blocks = block_sizes(rows)
        assert blocks == sorted(blocks, reverse=True)
        assert sum(blocks[:-1]) < rows <= sum(blocks)
        assert sum(blocks) - rows <= max(rows / 7, 31)
        sizes.update(blocks)
    assert sizes == {2**power for power in range(LARGEST_BLOCK.bit_length())}


@pytest.mark.parametrize("layer_norm", [False, True])
def test_lower_precision_rounds_the_products_between_hidden_layers_only(layer_norm: bool) -> None:
    network = mlp(4, (64, 64), 3, generator(), layer_norm=layer_norm)
    inputs = torch.randn(100, 4, generator=generator(1))
    exact = forward(network, inputs, torch.float32)
    rounded = forward(network, inputs, torch.bfloat16)
    assert torch.equal(exact, network(inputs))
    assert rounded.dtype == torch.float32
    assert not torch.equal(rounded, exact)
    torch.testing.assert_close(rounded, exact, rtol=0.0, atol=0.02)
    # Without a product between hidden layers nothing is rounded.
    shallow = mlp(4, (64,), 3, generator(), layer_norm=layer_norm)
    assert torch.equal(forward(shallow, inputs, torch.bfloat16), shallow(inputs))


def test_gradients_through_rounded_products_are_close_to_exact_ones() -> None:
    network = mlp(4, (64, 64), 1, generator(), layer_norm=True)
    inputs = torch.randn(256, 4, generator=generator(1), requires_grad=True)
    wanted = [inputs, *network.parameters()]
    found = {}
    for dtype in (torch.float32, torch.bfloat16):
        loss = forward(network, inputs, dtype).square().mean()
        found[dtype] = torch.autograd.grad(loss, wanted)
    for exact, rounded in zip(found[torch.float32], found[torch.bfloat16], strict=True):
        assert rounded.dtype == torch.float32
        assert (rounded - exact).norm() < 0.03 * exact.norm()
