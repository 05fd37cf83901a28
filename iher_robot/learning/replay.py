"""Episode replay of one source, with hindsight relabelling at sampling time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch

from iher_robot.learning.goal_model import GoalModel, Shapes
from iher_robot.learning.networks.data_parallel import Peers, local_rows

BLOCK = 40
"""Updates whose batches are drawn together: it costs little more than to draw one."""
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


@dataclass(frozen=True)
class Transitions:
    """A batch of transitions with goals and reward components.

    Attributes:
        observation: ``(batch, obs_dim)``
        action: ``(batch, action_dim)``
        next_observation: ``(batch, obs_dim)``
        goal: Desired goal, relabelled or original. ``(batch, goal_dim)``
        extrinsic: Sparse reward of the next observation under that goal. ``(batch,)``
        intrinsic: Cached curiosity reward. ``(batch,)``
        source: Index of the source. ``(batch,)``
    """

    observation: torch.Tensor
    action: torch.Tensor
    next_observation: torch.Tensor
    goal: torch.Tensor
    extrinsic: torch.Tensor
    intrinsic: torch.Tensor
    source: torch.Tensor

    @staticmethod
    def interleave(parts: list[Transitions], count: int) -> Transitions:
        """Join blocks of batches of several sources, each batch with its share of every source.

        Args:
            parts: Blocks of ``count`` batches, one behind the other.
            count: Batches.
        """

        def joined(field: str) -> torch.Tensor:
            batches = [getattr(part, field).unflatten(0, (count, -1)) for part in parts]
            return torch.cat(batches, dim=1).flatten(0, 1)

        return Transitions(**{field: joined(field) for field in Transitions.__dataclass_fields__})

    def split(self, count: int) -> list[Transitions]:
        """Cut into so many equal batches."""
        assert len(self.source) % count == 0, (len(self.source), count)
        fields = Transitions.__dataclass_fields__
        chunks = zip(*(getattr(self, f).chunk(count) for f in fields), strict=True)
        return [Transitions(*chunk) for chunk in chunks]

    def shard(self, count: int, peers: Peers) -> Transitions:
        """The equal share of each batch that one of several learners computes on.

        Args:
            count: Batches, one behind the other.
            peers: The learners.
        """
        if peers.world_size == 1:
            return self
        fields = Transitions.__dataclass_fields__
        return Transitions(**{f: local_rows(getattr(self, f), count, peers) for f in fields})


class EpisodeReplay:
    """Whole episodes of one source, first in, first out.

    Episodes may be shorter than the longest one. Sampling costs the logarithm of the number of
    stored episodes. Achieved goals are not stored: they are a function of the observation.

    Args:
        shapes: Sizes of the arrays.
        capacity: Transitions to keep, rounded down to whole episodes of full length.
        source: Index of the source, returned with every sample.
        device: Where the data live.
        between: Learn from actions anywhere between the applied and the requested one.
    """

    def __init__(
        self,
        shapes: Shapes,
        *,
        capacity: int,
        source: int,
        device: torch.device,
        between: bool = False,
    ) -> None:
        self.shapes = shapes
        self._between = between
        self.source = source
        self.max_episodes = max(1, capacity // shapes.episode_ticks)
        episodes, ticks = self.max_episodes, shapes.episode_ticks
        self._observations = torch.empty(episodes, ticks + 1, shapes.obs_dim, device=device)
        self._actions = torch.empty(episodes, ticks, shapes.action_dim, device=device)
        self._requested = torch.empty(
            episodes if between else 0, ticks, shapes.action_dim, device=device
        )
        self._goals = torch.empty(episodes, shapes.goal_dim, device=device)
        self._intrinsic = torch.zeros(episodes, ticks, device=device)
        self._lengths = torch.zeros(episodes, dtype=torch.long, device=device)
        self._epochs = torch.zeros(episodes, dtype=torch.long, device=device)
        self._weights = torch.ones(episodes, dtype=torch.float64, device=device)
        self.num_episodes = 0
        self._next_slot = 0
        self._cumulative: torch.Tensor | None = None
        self._cumulative_weights: torch.Tensor | None = None

    @property
    def num_transitions(self) -> int:
        """Transitions that are stored now."""
        return int(self._lengths[: self.num_episodes].sum())

    @property
    def newest_epoch(self) -> int:
        """Epoch of the newest stored episode."""
        return int(self._epochs[: self.num_episodes].max()) if self.num_episodes else 0

    def clear(self) -> None:
        """Forget every episode."""
        self.num_episodes = 0
        self._next_slot = 0
        self._cumulative = None

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
            actions: As they were applied. ``(episodes, length, action_dim)``
            goals: ``(episodes, goal_dim)``
            epoch: Epoch in which they were collected, from 1.
            requested: Actions as they were asked for; the applied ones where none are given.
                ``(episodes, length, action_dim)``
            intrinsic: Intrinsic rewards; zero where none are given. ``(episodes, length)``
            weight: How likely ``sample`` draws one of their transitions, against others.
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
        if self._between:
            asked = actions if requested is None else requested
            self._requested[slots, :length] = asked.to(self._requested.dtype)
        self._goals[slots] = goals.to(self._goals.dtype)
        self._intrinsic[slots] = 0.0
        if intrinsic is not None:
            self._intrinsic[slots, :length] = intrinsic
        self._lengths[slots] = length
        self._epochs[slots] = epoch
        self._weights[slots] = weight
        self._next_slot = (self._next_slot + count) % self.max_episodes
        self.num_episodes = min(self.num_episodes + count, self.max_episodes)
        self._cumulative = None

    def draw(
        self, count: int, generator: torch.Generator, epoch_weights: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw transitions in proportion to a weight of their episode or of its epoch.

        Args:
            count: How many, with replacement.
            generator: Source of randomness.
            epoch_weights: Weight of a transition by its epoch, ``(epochs + 1,)``; None for
                the weights that their episodes were added with.

        Returns:
            Episode slot and tick of each. ``(count,)``, ``(count,)``
        """
        cumulative, weights = self._masses(epoch_weights)
        point = torch.rand(
            count, generator=generator, dtype=torch.float64, device=cumulative.device
        )
        point *= cumulative[-1]
        episode = torch.searchsorted(cumulative, point, right=True)
        episode.clamp_(max=self.num_episodes - 1)
        before = torch.where(episode > 0, cumulative[(episode - 1).clamp_min(0)], 0.0)
        tick = ((point - before) / weights[episode]).long()
        return episode, torch.minimum(tick.clamp_min(0), self._lengths[episode] - 1)

    def _masses(self, epoch_weights: torch.Tensor | None) -> tuple[torch.Tensor, torch.Tensor]:
        """Cumulative sampling mass of the episodes, and each one's weight a transition."""
        if self.num_episodes == 0:
            raise ValueError(f"cannot sample: the source {self.source} holds no episode")
        if epoch_weights is None and self._cumulative is not None:
            assert self._cumulative_weights is not None
            return self._cumulative, self._cumulative_weights
        lengths = self._lengths[: self.num_episodes].double()
        if epoch_weights is None:
            weights = self._weights[: self.num_episodes]
            self._cumulative, self._cumulative_weights = (lengths * weights).cumsum(0), weights
            return self._cumulative, weights
        weights = epoch_weights.double()[self._epochs[: self.num_episodes]]
        return (lengths * weights).cumsum(0), weights

    def steps(
        self, episode: torch.Tensor, tick: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Observation, action and next observation of the given ticks."""
        return (
            self._observations[episode, tick],
            self._actions[episode, tick],
            self._observations[episode, tick + 1],
        )

    def draw_steps(
        self, episode: torch.Tensor, tick: torch.Tensor, generator: torch.Generator
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Observation, action and next observation of the given ticks, to learn from.

        Where a request was cut down to what the robot can do, any action on the way from the
        applied to the requested one would have come to the same; with ``between`` one is drawn.
        Learned from the applied ones alone, values of what cannot be done would be made up.

        Args:
            episode: Slot of each.
            tick: Tick of each.
            generator: Source of randomness.
        """
        observation, action, following = self.steps(episode, tick)
        if self._between:
            share = torch.rand(len(tick), 1, generator=generator, device=action.device)
            action = torch.lerp(action, self._requested[episode, tick], share)
        return observation, action, following

    def sample(
        self,
        count: int,
        generator: torch.Generator,
        goal_model: GoalModel,
        *,
        future_fraction: float,
    ) -> Transitions:
        """Sample transitions, relabelled with the ``future`` strategy.

        A relabelled goal is one achieved at a later tick of the same episode, drawn uniformly
        (Andrychowicz et al. 2017, section 4.5), and the reward is recomputed for it.

        Args:
            count: How many, with replacement.
            generator: Source of randomness.
            goal_model: Rewards and achieved goals.
            future_fraction: Share of transitions to relabel.

        Returns:
            The batch.
        """
        episode, tick = self.draw(count, generator)
        observation, action, following = self.draw_steps(episode, tick, generator)
        device = observation.device
        ahead = torch.rand(count, generator=generator, device=device)
        relabel = torch.rand(count, generator=generator, device=device) < future_fraction
        remaining = self._lengths[episode] - tick
        later = tick + 1 + torch.minimum((ahead * remaining).long(), remaining - 1)
        hindsight = goal_model.achieved_goal(self._observations[episode, later])
        goal = torch.where(relabel.unsqueeze(-1), hindsight, self._goals[episode])
        return Transitions(
            observation=observation,
            action=action,
            next_observation=following,
            goal=goal,
            extrinsic=goal_model.compute_reward(goal_model.achieved_goal(following), goal),
            intrinsic=self._intrinsic[episode, tick],
            source=torch.full((count,), self.source, device=device),
        )

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
        self._cumulative = None

    def every_step(self) -> tuple[torch.Tensor, torch.Tensor]:
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
