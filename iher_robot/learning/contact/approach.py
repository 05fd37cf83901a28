"""Acting with the second policy: an episode of approaches, from every side, with an open hand."""

from __future__ import annotations

import torch

from iher_robot.learning.config import ContactConfig
from iher_robot.learning.contact.model import ContactModel, distance_between, touched
from iher_robot.learning.goal_model import REAL
from iher_robot.learning.policy import Policy

LEG_TICKS = 15
"""Ticks after which a point around the object is given up if it was not reached."""


def _bernoulli(share: float, generator: torch.Generator) -> bool:
    return bool(torch.rand((), generator=generator) < share)


class ContactPolicy:
    """Snapshot of the second policy, for exploration.

    Args:
        policy: Its weights.
        model: Positions of effector and object.
        config: Shares of episodes and steps, definition of a touch.
        rests: Whether its training has ended; it then explores in a share of the episodes only.
    """

    def __init__(
        self, policy: Policy, model: ContactModel, config: ContactConfig, *, rests: bool
    ) -> None:
        self._policy = policy
        self._rests = rests
        self._model = model
        self._config = config

    def begin(
        self, observation: torch.Tensor, generator: torch.Generator
    ) -> ApproachEpisode | None:
        """Begin an episode; None if this policy does not explore in it.

        Args:
            observation: First observation. ``(1, obs_dim)``
            generator: Draws whether it explores, and the first leg.
        """
        if self._rests and not _bernoulli(self._config.episodes, generator):
            return None
        return ApproachEpisode(self, self._model, self._config, observation, generator)

    def act(self, observation: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        """Action towards a position, without noise. ``(1, obs_dim), (1, 3) -> (1, action_dim)``"""
        source = torch.full((len(observation),), REAL)
        return self._policy.act(observation, target, source)


class ApproachEpisode:
    """Approaches to the object in one episode, leg by leg: to a point around it, then to itself.

    The hand, if there is one, has a constant command for a whole leg: open on the way to the
    object, open or closed on the way to a point around it.

    Args:
        policy: The second policy.
        model: Positions of effector and object.
        config: Share of the steps, definition of a touch, what follows one.
        start: First observation. ``(1, obs_dim)``
        generator: Draws the legs.
    """

    def __init__(
        self,
        policy: ContactPolicy,
        model: ContactModel,
        config: ContactConfig,
        start: torch.Tensor,
        generator: torch.Generator,
    ) -> None:
        self._policy = policy
        self._model = model
        self._config = config
        self._finished = False
        self._around: torch.Tensor | None = None
        self._wait_ticks = 0
        self._begin_leg(start, generator, around=_bernoulli(config.around_share, generator))
        self._wait_ticks = 0  # at the start the hand holds nothing to release

    def _begin_leg(
        self, observation: torch.Tensor, generator: torch.Generator, *, around: bool
    ) -> None:
        self._object_start = self._model.object_position(observation)
        self._ticks = 0
        self._around = None
        if around:
            axes = self._object_start.shape[-1]
            drawn = 2.0 * torch.rand(axes, generator=generator) - 1.0
            drawn[2:] = drawn[2:].abs()  # above the object
            self._around = self._object_start + self._config.around_m * drawn
        if hand := self._model.hand_actions:
            self._hand = torch.ones(len(hand))
            if around:
                self._hand -= 2.0 * torch.randint(2, (len(hand),), generator=generator)
            self._wait_ticks = self._config.hand_ticks

    def act(self, observation: torch.Tensor, generator: torch.Generator) -> torch.Tensor | None:
        """Action of the second policy; None if the main policy takes this step.

        Args:
            observation: ``(1, obs_dim)``
            generator: Draws which policy takes the step, and the next leg.

        Returns:
            ``(1, action_dim)``
        """
        self._advance(observation, generator)
        if self._finished or not _bernoulli(self._config.share, generator):
            return None
        action = self._policy.act(observation, self._target(observation))
        return torch.zeros_like(action) if self._wait_ticks else action

    def restore_hand(self, action: torch.Tensor, noisy: torch.Tensor) -> torch.Tensor:
        """Remove the noise from the hand's command, and from the whole action while the hand moves.

        Args:
            action: From ``act``. ``(1, action_dim)``
            noisy: The same with noise. ``(1, action_dim)``
        """
        if not self._model.hand_actions:
            return noisy
        restored = (action if self._wait_ticks else noisy).clone()
        restored[:, list(self._model.hand_actions)] = self._hand
        return restored

    def _target(self, observation: torch.Tensor) -> torch.Tensor:
        return self._model.object_position(observation) if self._around is None else self._around

    def _advance(self, observation: torch.Tensor, generator: torch.Generator) -> None:
        """Begin the next leg if this one has ended."""
        if self._finished:
            return
        if self._wait_ticks:
            self._wait_ticks -= 1
            return
        self._ticks += 1
        if self._around is not None:
            distance = distance_between(self._model.effector_position(observation), self._around)
            if distance < self._config.radius_m or self._ticks > LEG_TICKS:
                self._begin_leg(observation, generator, around=False)
            return
        least = self._config.again_m or self._config.touched_m
        if touched(self._model, self._object_start, observation, self._config.radius_m, least):
            once = self._config.again_m is None
            self._finished = once or _bernoulli(self._config.hand_over, generator)
            if not self._finished:
                around = _bernoulli(self._config.around_share, generator)
                self._begin_leg(observation, generator, around=around)
