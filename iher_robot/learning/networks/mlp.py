"""Feed-forward networks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import torch
from torch import nn
from torch.nn import functional

LARGEST_BLOCK = 4096
"""Rows that ``in_blocks`` computes at once, at most; a power of two."""


def mlp(
    inputs: int,
    hidden: Sequence[int],
    outputs: int,
    generator: torch.Generator,
    *,
    layer_norm: bool = False,
) -> nn.Sequential:
    """Multi-layer perceptron with ReLU between its layers.

    The weights are drawn from ``generator`` with torch's default distribution, so that nothing
    depends on the global seed.

    Args:
        inputs: Width of the input.
        hidden: Widths of the hidden layers.
        outputs: Width of the output, which is linear.
        generator: Source of randomness, on the CPU.
        layer_norm: Normalise each hidden layer before its ReLU.

    Returns:
        The network, on the CPU.
    """
    widths = [inputs, *hidden, outputs]
    layers: list[nn.Module] = []
    for fan_in, fan_out in pairwise(widths):
        layer = nn.Linear(fan_in, fan_out)
        bound = fan_in**-0.5
        with torch.no_grad():
            for parameter in (layer.weight, layer.bias):
                parameter.uniform_(-bound, bound, generator=generator)
        if layers:
            layers += [nn.LayerNorm(fan_in)] * layer_norm + [nn.ReLU(inplace=True)]
        layers.append(layer)
    return nn.Sequential(*layers)


def forward(network: nn.Sequential, inputs: torch.Tensor, products: torch.dtype) -> torch.Tensor:
    """Apply what ``mlp`` returned, with matrix products between hidden layers of a type.

    The first and the last layer are not rounded: what a network sees and says stays exact. Nor is
    anything between the products, which on a CPU would cost more than it saves.

    Args:
        network: From ``mlp``.
        inputs: ``(rows, inputs)``
        products: Type of the products; weights and results stay what they are.

    Returns:
        ``(rows, outputs)``
    """
    if products == inputs.dtype:
        output: torch.Tensor = network(inputs)
        return output
    values, last = inputs, len(network) - 1
    for index, layer in enumerate(network):
        if isinstance(layer, nn.Linear) and 0 < index < last:
            product = functional.linear(values.to(products), layer.weight.to(products))
            values = product.to(inputs.dtype).add_(layer.bias)
        else:
            values = layer(values)
    return values


def in_blocks(
    network: Callable[[torch.Tensor], torch.Tensor], inputs: torch.Tensor
) -> torch.Tensor:
    """Apply a network to any number of rows, in blocks whose sizes are powers of two.

    On a CPU torch has a matrix product compiled for each shape that it meets (oneDNN, in every
    precision but ``highest``) and keeps the code, about 1 MB a layer: numbers of rows that are
    never twice the same would fill gigabytes.

    Args:
        network: Computes each row by itself.
        inputs: ``(rows, inputs)``

    Returns:
        ``(rows, outputs)``
    """
    sizes = block_sizes(len(inputs))
    if inputs.device.type != "cpu" or sizes == [len(inputs)] or not sizes:
        return network(inputs)
    outputs, begin = [], 0
    for size in sizes:
        rows = inputs[begin : begin + size]
        padded = functional.pad(rows, (0, 0, 0, size - len(rows)))
        outputs.append(network(padded)[: len(rows)])
        begin += size
    return torch.cat(outputs)


def block_sizes(rows: int) -> list[int]:
    """Powers of two that hold so many rows; the last one may be larger than what is left for it.

    Args:
        rows: How many.

    Returns:
        Sizes from the largest to the smallest.
    """
    sizes, left = [], rows
    while left > 0:
        size = min(LARGEST_BLOCK, 1 << (left - 1).bit_length())
        if size > 64 and left < 0.875 * size:  # more calls cost less than so many rows of nothing
            size //= 2
        sizes.append(size)
        left -= size
    return sizes
