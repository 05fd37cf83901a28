"""Feed-forward networks."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import nn


def mlp(
    inputs: int,
    hidden: Sequence[int],
    outputs: int,
    generator: torch.Generator,
    *,
    layer_norm: bool = False,
) -> nn.Module:
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
