"""Parameters of a module in one contiguous tensor."""

from __future__ import annotations

import torch
from torch import nn

from iher_robot.learning.networks.data_parallel import Peers

ALIGNMENT = 16
"""Each parameter begins at a multiple of this many elements: one cache line of a CPU."""


class FlatParameters:
    """All parameters of a module as one tensor, and all of their gradients as another.

    An optimiser step, a running mean or an average over processes is then one operation, whatever
    the number of layers. The module's parameters become views.

    Args:
        module: A module that stays on its device. It is changed in place.

    Attributes:
        values: The parameters, concatenated; its ``grad`` holds their gradients.
        parameters: The module's parameters, which are views of ``values``.
    """

    def __init__(self, module: nn.Module) -> None:
        self.parameters = list(module.parameters())
        sizes = [-(-each.numel() // ALIGNMENT) * ALIGNMENT for each in self.parameters]
        self.values = nn.Parameter(self.parameters[0].new_zeros(sum(sizes)))
        self.values.grad = torch.zeros_like(self.values)
        pieces = zip(
            self.parameters,
            self.values.detach().split(sizes),
            self.values.grad.split(sizes),
            strict=True,
        )
        for parameter, values, gradient in pieces:
            place = values[: parameter.numel()].view_as(parameter)
            place.copy_(parameter.detach())
            parameter.data = place
            parameter.grad = gradient[: parameter.numel()].view_as(parameter)

    @torch.no_grad()
    def move_towards(self, source: FlatParameters, share: float | torch.Tensor) -> None:
        """Move by a share towards the parameters of a module of the same shape."""
        self.values.lerp_(source.values, share)

    def clear_gradients(self) -> None:
        """Set all gradients to zero."""
        assert self.values.grad is not None
        self.values.grad.zero_()

    def add_gradients(self, loss: torch.Tensor) -> None:
        """Add the gradients of a loss; other modules get none."""
        loss.backward(inputs=self.parameters)

    def average_gradients(self, peers: Peers) -> None:
        """Replace the gradients by their mean over all learners."""
        assert self.values.grad is not None
        peers.average(self.values.grad)
