"""Multi-layer perceptrons."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import torch
from torch import nn
from torch.nn import functional

LARGEST_BLOCK = 4096
"""Most rows that ``in_blocks`` computes at once; a power of two."""


def mlp(
    inputs: int,
    hidden: Sequence[int],
    outputs: int,
    generator: torch.Generator,
    *,
    layer_norm: bool = False,
) -> nn.Sequential:
    """Multi-layer perceptron with ReLU between its layers.

    The weights are drawn from ``generator`` with torch's default distribution; the global seed has
    no effect.

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


def forward(network: nn.Sequential, inputs: torch.Tensor, dtype: torch.dtype) -> torch.Tensor:
    """Apply an ``mlp``, with the matrix products between hidden layers in a given type.

    The first and the last layer are not rounded, so that inputs and outputs stay exact. Nor is
    anything between the products: on a CPU that would cost more than it saves.

    Args:
        network: From ``mlp``.
        inputs: ``(rows, inputs)``
        dtype: Type of these products; weights and results keep theirs.

    Returns:
        ``(rows, outputs)``
    """
    if dtype == inputs.dtype:
        output: torch.Tensor = network(inputs)
        return output
    values, last = inputs, len(network) - 1
    for index, layer in enumerate(network):
        if isinstance(layer, nn.Linear) and 0 < index < last:
            product = functional.linear(values.to(dtype), layer.weight.to(dtype))
            values = product.to(inputs.dtype).add_(layer.bias)
        else:
            values = layer(values)
    return values


def in_blocks(
    network: Callable[[torch.Tensor], torch.Tensor], inputs: torch.Tensor
) -> torch.Tensor:
    """Apply a network to any number of rows, in blocks whose sizes are powers of two.

    On a CPU torch compiles a matrix product for each new shape (oneDNN, in every precision but
    ``highest``) and keeps the code, about 1 MB a layer: ever new numbers of rows would fill
    gigabytes.

    Args:
        network: Computes each row independently of the others.
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
    """Split rows into blocks whose sizes are powers of two; the last may need padding.

    Args:
        rows: Number of rows.

    Returns:
        Sizes from the largest to the smallest.
    """
    sizes, left = [], rows
    while left > 0:
        size = min(LARGEST_BLOCK, 1 << (left - 1).bit_length())
        if size > 64 and left < 0.875 * size:  # another call costs less than this much padding
            size //= 2
        sizes.append(size)
        left -= size
    return sizes
