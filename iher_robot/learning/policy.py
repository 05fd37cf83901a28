"""The policy: actor and input normalisers, without critics and optimisers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import nn

from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.goal_model import SOURCES, Shapes, source_features
from iher_robot.learning.networks.mlp import forward, in_blocks, mlp
from iher_robot.learning.networks.normalizer import RunningNormalizer
from iher_robot.learning.networks.precision import pick_matmul_dtype


class Policy:
    """Deterministic actor with its input normalisers.

    Args:
        shapes: Sizes of the arrays.
        hidden: Widths of the actor's hidden layers.
        source_input: Whether the data's source is an input of the actor.
        inputs: ``absolute`` or ``relative``, see ``DDPGConfig``.
        normalizer_clip: See ``ReplayConfig``.
        normalizer_std_floor: See ``ReplayConfig``.
        generator: Draws the initial weights.
        device: Where the policy computes.
        matmul_dtype: Type of the matrix products between hidden layers.
    """

    def __init__(
        self,
        shapes: Shapes,
        *,
        hidden: Sequence[int],
        source_input: bool,
        inputs: str = "absolute",
        normalizer_clip: float,
        normalizer_std_floor: float,
        generator: torch.Generator,
        device: torch.device,
        matmul_dtype: torch.dtype = torch.float32,
    ) -> None:
        self.shapes = shapes
        self.hidden = tuple(hidden)
        self.source_input = source_input
        self.inputs = inputs
        self.device = device
        self.matmul_dtype = matmul_dtype

        def normalizer(dim: int) -> RunningNormalizer:
            return RunningNormalizer(
                dim, clip=normalizer_clip, std_floor=normalizer_std_floor, device=device
            )

        self.obs_normalizer = normalizer(shapes.obs_dim)
        self.goal_normalizer = normalizer(shapes.goal_dim)
        self.gap_normalizer = normalizer(len(shapes.goal_entries))
        self._goal_entries = torch.tensor(shapes.goal_entries, dtype=torch.long, device=device)
        # 0 for entries that a shift of the whole scene changes, else 1.
        self._fixed = torch.ones(shapes.obs_dim, device=device)
        self._fixed[list(shapes.shifted_entries)] = 0.0
        self.actor = mlp(self.input_dim, hidden, shapes.action_dim, generator).to(device)

    @classmethod
    def from_config(
        cls,
        shapes: Shapes,
        config: LearnerConfig,
        *,
        generator: torch.Generator,
        device: torch.device,
    ) -> Policy:
        """Build an untrained policy from the learner's settings."""
        return cls(
            shapes,
            hidden=config.ddpg.hidden,
            source_input=config.ddpg.source_input,
            inputs=config.ddpg.inputs,
            normalizer_clip=config.replay.normalizer_clip,
            normalizer_std_floor=config.replay.normalizer_std_floor,
            generator=generator,
            device=device,
            matmul_dtype=pick_matmul_dtype(config.matmul_precision, device),
        )

    @property
    def input_dim(self) -> int:
        """Width of the actor's input."""
        sources = len(SOURCES) - 1 if self.source_input else 0
        gap = len(self.shapes.goal_entries) if self.inputs == "relative" else 0
        return self.shapes.obs_dim + self.shapes.goal_dim + gap + sources

    def update_normalizers(self, observation: torch.Tensor, goal: torch.Tensor) -> None:
        """Add observations and goals. ``(batch, obs_dim)``, ``(batch, goal_dim)``"""
        self.obs_normalizer.update(observation)
        self.goal_normalizer.update(goal)
        if self.shapes.goal_entries:
            self.gap_normalizer.update(self._gap(observation, goal))

    def _gap(self, observation: torch.Tensor, goal: torch.Tensor) -> torch.Tensor:
        return goal - observation[..., self._goal_entries]

    def features(
        self, observation: torch.Tensor, goal: torch.Tensor, source: torch.Tensor
    ) -> torch.Tensor:
        """Input of actor and critics: normalised observation and goal, and the source.

        Args:
            observation: ``(batch, obs_dim)``
            goal: ``(batch, goal_dim)``
            source: Index of each row's source. ``(batch,)``

        Returns:
            ``(batch, input_dim)``
        """
        parts = [self.obs_normalizer(observation), self.goal_normalizer(goal)]
        if self.inputs == "relative":
            parts[0] = parts[0] * self._fixed
            parts[1] = parts[1] * self._fixed[self._goal_entries]
            parts.append(self.gap_normalizer(self._gap(observation, goal)))
        if self.source_input:
            parts.append(source_features(source))
        return torch.cat(parts, dim=-1)

    def action(self, features: torch.Tensor, actor: nn.Sequential | None = None) -> torch.Tensor:
        """Action for the features, in [-1, 1].

        Args:
            features: ``(batch, input_dim)``
            actor: Another actor of the same shape, such as a target; None for the policy's.

        Returns:
            ``(batch, action_dim)``
        """
        return torch.tanh(forward(actor or self.actor, features, self.matmul_dtype))

    @torch.no_grad()
    def act(
        self, observation: torch.Tensor, goal: torch.Tensor, source: torch.Tensor
    ) -> torch.Tensor:
        """Action without noise. ``(batch, obs_dim), (batch, goal_dim), (batch,)``"""
        features = self.features(observation, goal, source)
        return in_blocks(self.action, features)

    def snapshot(self) -> dict[str, Any]:
        """Copy of everything that acting needs: tensors and plain values only."""
        return {
            "shapes": {name: getattr(self.shapes, name) for name in Shapes.__dataclass_fields__},
            "hidden": list(self.hidden),
            "source_input": self.source_input,
            "inputs": self.inputs,
            "normalizer_clip": self.obs_normalizer.clip,
            "normalizer_std_floor": self.obs_normalizer.std_floor,
            "actor": {name: t.detach().clone() for name, t in self.actor.state_dict().items()},
            "obs_normalizer": self.obs_normalizer.state_dict(),
            "goal_normalizer": self.goal_normalizer.state_dict(),
            "gap_normalizer": self.gap_normalizer.state_dict(),
        }

    def load_snapshot(self, snapshot: dict[str, Any]) -> None:
        """Load the weights and statistics of a snapshot of the same shapes."""
        self.actor.load_state_dict(snapshot["actor"])
        self.obs_normalizer.load_state_dict(snapshot["obs_normalizer"])
        self.goal_normalizer.load_state_dict(snapshot["goal_normalizer"])
        if "gap_normalizer" in snapshot:  # not in policy files of format 1
            self.gap_normalizer.load_state_dict(snapshot["gap_normalizer"])

    @classmethod
    def from_snapshot(
        cls,
        snapshot: dict[str, Any],
        *,
        device: torch.device,
        matmul_dtype: torch.dtype = torch.float32,
    ) -> Policy:
        """Build the policy of a snapshot.

        Args:
            snapshot: From ``snapshot``.
            device: Where the policy computes.
            matmul_dtype: Type of the matrix products between hidden layers.

        Raises:
            AttributeError, KeyError, RuntimeError, TypeError, ValueError: It is no such snapshot.
        """
        policy = cls(
            Shapes(**snapshot["shapes"]),
            hidden=snapshot["hidden"],
            source_input=snapshot["source_input"],
            inputs=snapshot.get("inputs", "absolute"),  # not in policy files of format 1
            normalizer_clip=snapshot["normalizer_clip"],
            normalizer_std_floor=snapshot["normalizer_std_floor"],
            generator=torch.Generator(),
            device=device,
            matmul_dtype=matmul_dtype,
        )
        policy.load_snapshot(snapshot)
        shapes = policy.shapes
        sizes = {"obs": shapes.obs_dim, "goal": shapes.goal_dim, "gap": len(shapes.goal_entries)}
        for part, dim in sizes.items():
            # Unlike a module, a normaliser loads any shape; a wrong one might broadcast.
            name = f"{part}_normalizer"
            if name not in snapshot and dim == 0:
                continue
            for key in ("mean", "std"):
                found = tuple(snapshot[name][key].shape)
                if found != (dim,):
                    raise ValueError(f"{name}.{key} has shape {found}, expected {(dim,)}")
        return policy
