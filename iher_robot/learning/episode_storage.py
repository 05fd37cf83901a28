"""Ring buffer of whole episodes."""

from __future__ import annotations

from typing import Any

import torch

from iher_robot.learning.goal_model import Shapes

_STORED = (
    "observations",
    "actions",
    "requested",
    "goals",
    "intrinsic",
    "lengths",
    "epochs",
    "weights",
)


class EpisodeStorage:
    """Episodes in tensors of fixed size, first in, first out.

    Episodes may be shorter than the longest one. A stored transition is named by its episode's
    slot and its tick. Achieved goals are not stored: they are a function of the observation.

    Args:
        shapes: Sizes of the arrays.
        capacity: Transitions to keep, rounded down to whole episodes of full length.
        device: Where the data live.
        keep_requested: Whether requested actions are stored beside the applied ones.
    """

    def __init__(
        self, shapes: Shapes, *, capacity: int, device: torch.device, keep_requested: bool
    ) -> None:
        self.shapes = shapes
        self.max_episodes = max(1, capacity // shapes.episode_ticks)
        self._keep_requested = keep_requested
        episodes, ticks = self.max_episodes, shapes.episode_ticks
        self._observations = torch.empty(episodes, ticks + 1, shapes.obs_dim, device=device)
        self._actions = torch.empty(episodes, ticks, shapes.action_dim, device=device)
        self._requested = torch.empty(
            episodes if keep_requested else 0, ticks, shapes.action_dim, device=device
        )
        self._goals = torch.empty(episodes, shapes.goal_dim, device=device)
        self._intrinsic = torch.zeros(episodes, ticks, device=device)
        self._lengths = torch.zeros(episodes, dtype=torch.long, device=device)
        self._epochs = torch.zeros(episodes, dtype=torch.long, device=device)
        self._weights = torch.ones(episodes, dtype=torch.float64, device=device)
        self.num_episodes = 0
        self._next_slot = 0
        self._version = 0  # rises with every change of the stored episodes

    @property
    def num_transitions(self) -> int:
        """Transitions that are stored now."""
        return int(self._lengths[: self.num_episodes].sum())

    @property
    def newest_epoch(self) -> int:
        """Epoch of the newest stored episode."""
        return int(self._epochs[: self.num_episodes].max()) if self.num_episodes else 0

    def clear(self) -> None:
        """Remove every episode."""
        self.num_episodes = 0
        self._next_slot = 0
        self._version += 1

    def add(
        self,
        observations: torch.Tensor,
        actions: torch.Tensor,
        goals: torch.Tensor,
        *,
        epoch: int,
        requested: torch.Tensor | None = None,
        intrinsic: torch.Tensor | None = None,
        weight: float = 1.0,
    ) -> None:
        """Append episodes of one length.

        Args:
            observations: ``(episodes, length + 1, obs_dim)``
            actions: As applied. ``(episodes, length, action_dim)``
            goals: ``(episodes, goal_dim)``
            epoch: Epoch in which they were collected, from 1.
            requested: Actions as requested; None for the applied ones.
                ``(episodes, length, action_dim)``
            intrinsic: Intrinsic rewards; None for zero. ``(episodes, length)``
            weight: Sampling weight of each of their transitions.
        """
        count, length = actions.shape[:2]
        assert observations.shape == (count, length + 1, self.shapes.obs_dim), observations.shape
        assert 0 < length <= self.shapes.episode_ticks, length
        slots = (self._next_slot + torch.arange(count, device=actions.device)) % self.max_episodes
        if count > self.max_episodes:  # only the newest survive; writing all would race
            slots = slots[-self.max_episodes :]
            observations, actions = observations[-len(slots) :], actions[-len(slots) :]
            goals = goals[-len(slots) :]
            requested = None if requested is None else requested[-len(slots) :]
            intrinsic = None if intrinsic is None else intrinsic[-len(slots) :]
        self._observations[slots, : length + 1] = observations.to(self._observations.dtype)
        self._actions[slots, :length] = actions.to(self._actions.dtype)
        if self._keep_requested:
            requested = actions if requested is None else requested
            self._requested[slots, :length] = requested.to(self._requested.dtype)
        self._goals[slots] = goals.to(self._goals.dtype)
        self._intrinsic[slots] = 0.0
        if intrinsic is not None:
            self._intrinsic[slots, :length] = intrinsic
        self._lengths[slots] = length
        self._epochs[slots] = epoch
        self._weights[slots] = weight
        self._next_slot = (self._next_slot + count) % self.max_episodes
        self.num_episodes = min(self.num_episodes + count, self.max_episodes)
        self._version += 1

    def steps(
        self, episode: torch.Tensor, tick: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Observation, applied action and next observation of the given ticks."""
        return (
            self._observations[episode, tick],
            self._actions[episode, tick],
            self._observations[episode, tick + 1],
        )

    def all_indices(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Slot and tick of every stored transition, in order. ``(transitions,)`` each"""
        lengths = self._lengths[: self.num_episodes]
        ticks = torch.arange(self.shapes.episode_ticks, device=lengths.device)
        episode, tick = torch.nonzero(ticks < lengths.unsqueeze(-1), as_tuple=True)
        return episode, tick

    def start_observations(self) -> torch.Tensor:
        """First observation of every stored episode. ``(episodes, obs_dim)``"""
        return self._observations[: self.num_episodes, 0]

    def store_intrinsic(
        self, episode: torch.Tensor, tick: torch.Tensor, reward: torch.Tensor
    ) -> None:
        """Cache the intrinsic reward of the given ticks."""
        self._intrinsic[episode, tick] = reward

    def state_dict(self) -> dict[str, Any]:
        """All that is stored, as tensors."""
        stored = {name: getattr(self, f"_{name}")[: self.num_episodes] for name in _STORED}
        # Clones: a view would be saved with all of its capacity.
        state = {name: tensor.clone().cpu() for name, tensor in stored.items()}
        return state | {"next_slot": self._next_slot}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Replace what is stored by what ``state_dict`` returned."""
        self.num_episodes = len(state["lengths"])
        for name in _STORED:
            getattr(self, f"_{name}")[: self.num_episodes] = state[name]
        self._next_slot = state["next_slot"]
        self._version += 1
