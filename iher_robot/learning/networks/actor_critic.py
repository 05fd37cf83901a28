"""Actor, critics, their target networks and their optimisers."""

from __future__ import annotations

import copy
from typing import Any, Literal

import torch
from torch import nn

from iher_robot.learning.config import DDPGConfig
from iher_robot.learning.networks.critics import Critics
from iher_robot.learning.networks.data_parallel import Peers
from iher_robot.learning.networks.flat_parameters import FlatParameters


class ActorCritic:
    """Networks of an actor-critic algorithm, and the operations that change their weights.

    Args:
        actor: The actor, trained in place.
        critics: The critics, on the same device; trained in place.
        config: Learning rates and tau.
        capturable: Whether a CUDA graph may capture the optimisers' steps.
        peers: Learners over which gradients are averaged.

    Attributes:
        actor: Online actor.
        critics: Online critics.
        target_actor: Follows the actor by ``tau``.
        target_critics: Follow the critics by ``tau``.
        mean_actor: Running mean of the actor's weights.
    """

    def __init__(
        self,
        actor: nn.Sequential,
        critics: Critics,
        config: DDPGConfig,
        *,
        capturable: bool,
        peers: Peers,
    ) -> None:
        self.actor = actor
        self.critics = critics
        self.target_actor = copy.deepcopy(actor)
        self.target_critics = copy.deepcopy(critics)
        self.mean_actor = copy.deepcopy(actor)
        self._tau = config.tau
        self._capturable = capturable
        self._peers = peers
        self._flat = {name: FlatParameters(module) for name, module in self._modules().items()}
        self._optimizers = {
            name: torch.optim.Adam(
                [self._flat[name].values], lr=lr, fused=True, capturable=capturable
            )
            for name, lr in (("actor", config.actor_lr), ("critics", config.critic_lr))
        }

    def _modules(self) -> dict[str, nn.Module]:
        return {
            "actor": self.actor,
            "critics": self.critics,
            "target_actor": self.target_actor,
            "target_critics": self.target_critics,
            "mean_actor": self.mean_actor,
        }

    def gradient_step(self, name: Literal["actor", "critics"], loss: torch.Tensor) -> None:
        """Take a step of Adam on a loss; other networks that it depends on stay as they are."""
        flat = self._flat[name]
        flat.clear_gradients()
        flat.add_gradients(loss)
        flat.average_gradients(self._peers)
        self._optimizers[name].step()

    def update_mean_actor(self, share: torch.Tensor) -> None:
        """Move the mean actor towards the actor by a share."""
        self._flat["mean_actor"].move_towards(self._flat["actor"], share)

    def update_targets(self) -> None:
        """Move the target networks towards the online ones by ``tau``."""
        for name in ("actor", "critics"):
            self._flat[f"target_{name}"].move_towards(self._flat[name], self._tau)

    def state_dict(self) -> dict[str, Any]:
        """Copy of networks and optimisers, without the actor, which is saved with its policy."""
        state: dict[str, Any] = {
            name: module.state_dict() for name, module in self._modules().items() if name != "actor"
        }
        state["optimizers"] = {name: each.state_dict() for name, each in self._optimizers.items()}
        return copy.deepcopy(state)

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what ``state_dict`` returned."""
        for name, module in self._modules().items():
            if name != "actor":
                module.load_state_dict(state[name])
        # An optimiser keeps the tensors that it loads and writes to them.
        for name, optimizer in self._optimizers.items():
            optimizer.load_state_dict(copy.deepcopy(state["optimizers"][name]))
            for group in optimizer.param_groups:  # the state may come from another device
                group["capturable"] = self._capturable
