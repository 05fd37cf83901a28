"""Episode replay of one source, with hindsight relabelling at sampling time."""

from __future__ import annotations

import torch

from iher_robot.learning.episode_storage import EpisodeStorage
from iher_robot.learning.goal_model import GoalModel, Shapes
from iher_robot.learning.transitions import Transitions


class EpisodeReplay(EpisodeStorage):
    """Stored episodes of one source, and samples of their transitions.

    Sampling costs the logarithm of the number of stored episodes.

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
        super().__init__(shapes, capacity=capacity, device=device, keep_requested=between)
        self.source = source
        self._between = between
        self._cached_cumulative: torch.Tensor | None = None
        self._cached_version = -1

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
            count: Transitions, drawn with replacement.
            generator: Source of randomness.
            goal_model: Rewards and achieved goals.
            future_fraction: Share of transitions to relabel.

        Returns:
            The batch.
        """
        episode, tick = self.sample_indices(count, generator)
        observation, action, following = self.sample_steps(episode, tick, generator)
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

    def sample_steps(
        self, episode: torch.Tensor, tick: torch.Tensor, generator: torch.Generator
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Observation, action to learn from and next observation of the given ticks.

        With ``between`` the action is drawn between the applied and the requested one: where the
        robot clipped a request, every action in between has the same outcome. Learned from applied
        actions alone, the values of infeasible ones would be made up.

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

    def sample_indices(
        self, count: int, generator: torch.Generator, epoch_weights: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw transitions in proportion to their weights.

        Args:
            count: Transitions, drawn with replacement.
            generator: Source of randomness.
            epoch_weights: Weight of a transition by its epoch, ``(epochs + 1,)``; None for
                the weights with which their episodes were added.

        Returns:
            Episode slot and tick of each. ``(count,)``, ``(count,)``
        """
        if self.num_episodes == 0:
            raise ValueError(f"cannot sample: the source {self.source} holds no episode")
        cumulative, weights = self._cumulative_weights(epoch_weights)
        point = torch.rand(
            count, generator=generator, dtype=torch.float64, device=cumulative.device
        )
        point *= cumulative[-1]
        episode = torch.searchsorted(cumulative, point, right=True)
        episode.clamp_(max=self.num_episodes - 1)
        before = torch.where(episode > 0, cumulative[(episode - 1).clamp_min(0)], 0.0)
        tick = ((point - before) / weights[episode]).long()
        return episode, torch.minimum(tick.clamp_min(0), self._lengths[episode] - 1)

    def _cumulative_weights(
        self, epoch_weights: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Cumulative weight over the episodes, and the weight of a transition of each."""
        lengths = self._lengths[: self.num_episodes].double()
        if epoch_weights is not None:
            weights = epoch_weights.double()[self._epochs[: self.num_episodes]]
            return (lengths * weights).cumsum(0), weights
        weights = self._weights[: self.num_episodes]
        if self._cached_cumulative is None or self._cached_version != self._version:
            self._cached_cumulative = (lengths * weights).cumsum(0)
            self._cached_version = self._version
        return self._cached_cumulative, weights
