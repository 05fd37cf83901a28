"""Critics: an ensemble of Q-networks for each component of the reward."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import nn

from iher_robot.learning.config import DDPGConfig
from iher_robot.learning.networks.mlp import forward, mlp


class Critics(nn.Module):
    """Q-networks that differ only in their initial weights.

    Args:
        inputs: Width of features and action together.
        config: Networks a component, their widths and layer normalisation.
        components: Components of the reward, each with its own networks.
        generator: Draws the initial weights, on the CPU.
        matmul_dtype: Type of the matrix products between hidden layers.
    """

    def __init__(
        self,
        inputs: int,
        config: DDPGConfig,
        *,
        components: int,
        generator: torch.Generator,
        matmul_dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        self._members = config.critics
        self._components = components
        self._matmul_dtype = matmul_dtype
        self.networks = nn.ModuleList(
            mlp(inputs, config.hidden, 1, generator, layer_norm=config.layer_norm)
            for _ in range(components * config.critics)
        )

    def forward(
        self, features: torch.Tensor, action: torch.Tensor, members: Sequence[int] | None = None
    ) -> torch.Tensor:
        """Values of actions.

        Args:
            features: Of observation and goal. ``(batch, input_dim)``
            action: ``(batch, action_dim)``
            members: Networks of each component to evaluate; None for all.

        Returns:
            ``(components, members, batch)``
        """
        inputs = torch.cat([features, action], dim=-1)
        chosen = range(self._members) if members is None else members
        # One after the other: the activations of one network fit in a CPU cache.
        values: list[torch.Tensor] = [
            forward(self._network(component, member), inputs, self._matmul_dtype).squeeze(-1)
            for component in range(self._components)
            for member in chosen
        ]
        stacked = torch.stack(values)
        return stacked.view(self._components, len(chosen), len(inputs))

    def _network(self, component: int, member: int) -> nn.Sequential:
        network = self.networks[component * self._members + member]
        assert isinstance(network, nn.Sequential)
        return network
