"""Parameters of a module in one piece of memory."""

from __future__ import annotations

import torch
from torch import nn

from iher_robot.learning.networks.data_parallel import Peers

ALIGNMENT = 16
"""Each parameter begins at a multiple of so many numbers: a line of the processor's cache."""


class FlatParameters:
    """All parameters of a module as one tensor, and all of their gradients as another.

    An optimiser, a running mean or an average over processes is then one operation, whatever the
    number of layers. The module's own parameters become views.

    Args:
        module: A module that stays on its device. It is changed in place.

    Attributes:
        values: The parameters, one behind the other; its ``grad`` holds their gradients.
        parameters: The module's own, which are views of it.
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
    def follow(self, source: FlatParameters, share: float | torch.Tensor) -> None:
        """Move towards the parameters of a module of the same kind by a share."""
        self.values.lerp_(source.values, share)

    def clear_gradients(self) -> None:
        """Set all gradients to zero."""
        assert self.values.grad is not None
        self.values.grad.zero_()

    def add_gradients(self, loss: torch.Tensor) -> None:
        """Add the gradients of a loss; those of other modules are left alone."""
        loss.backward(inputs=self.parameters)

    def average_gradients(self, peers: Peers) -> None:
        """Replace the gradients by the mean of all learners'."""
        assert self.values.grad is not None
        peers.average(self.values.grad)
