"""One episode of going to the object, from every side and with an open hand."""

from __future__ import annotations

import torch

from iher_robot.learning.config import ContactConfig
from iher_robot.learning.contact.model import ContactModel, apart, touched
from iher_robot.learning.goal_model import REAL
from iher_robot.learning.policy import Policy

LEG_TICKS = 15
"""Ticks after which a point around the object that was not reached is given up."""


def _chance(share: float, generator: torch.Generator) -> bool:
    return bool(torch.rand((), generator=generator) < share)


class ContactPolicy:
    """The second policy as it explores.

    Args:
        policy: Its weights.
        model: Where effector and object are.
        config: How much it explores, and what a touch is.
        rests: Whether it has a part in a share of the episodes only; before, in all of them.
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
        """Begin an episode; None where this policy has no part in it.

        Args:
            observation: Where it begins. ``(1, obs_dim)``
            generator: Draws whether it has.
        """
        if self._rests and not _chance(self._config.episodes, generator):
            return None
        return ApproachEpisode(self, self._model, self._config, observation, generator)

    def act(self, observation: torch.Tensor, place: torch.Tensor) -> torch.Tensor:
        """Action towards a place, without noise. ``(1, obs_dim), (1, 3) -> (1, action_dim)``"""
        source = torch.full((len(observation),), REAL)
        return self._policy.act(observation, place, source)


class ApproachEpisode:
    """One episode of going to the object, leg by leg: to a point around it, or to itself.

    In a leg the hand, if there is one, is told the same all the way: to open on the way to the
    object, to open or to close on the way from it.

    Args:
        policy: Who goes there.
        model: Where effector and object are.
        config: How much of the steps are its, what a touch is, and whether one is enough.
        start: Observation that the episode begins with. ``(1, obs_dim)``
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
        self._over = False
        self._around: torch.Tensor | None = None
        self._waits = 0
        self._begin_leg(start, generator, around=_chance(config.around_share, generator))
        self._waits = 0  # the first leg begins with nothing to let go of

    def _begin_leg(
        self, observation: torch.Tensor, generator: torch.Generator, *, around: bool
    ) -> None:
        self._before = self._model.object_position(observation)
        self._ticks = 0
        self._around = None
        if around:
            drawn = 2.0 * torch.rand(self._before.shape[-1], generator=generator) - 1.0  # on CPU
            drawn[2:] = drawn[2:].abs()  # up
            self._around = self._before + self._config.around_m * drawn
        if hand := self._model.hand_actions:
            self._hand = torch.ones(len(hand))
            if around:
                self._hand -= 2.0 * torch.randint(2, (len(hand),), generator=generator)
            self._waits = self._config.hand_ticks

    def act(self, observation: torch.Tensor, generator: torch.Generator) -> torch.Tensor | None:
        """Action of the second policy, if this step is its; None for the policy's own.

        Args:
            observation: ``(1, obs_dim)``
            generator: Draws whose step it is, and the next leg.

        Returns:
            ``(1, action_dim)``
        """
        self._follow(observation, generator)
        if self._over or not _chance(self._config.share, generator):
            return None
        action = self._policy.act(observation, self._place(observation))
        return torch.zeros_like(action) if self._waits else action

    def steady(self, meant: torch.Tensor, disturbed: torch.Tensor) -> torch.Tensor:
        """Take noise off where it would undo the leg: off the hand, and all while that moves.

        Args:
            meant: What ``act`` returned. ``(1, action_dim)``
            disturbed: The same with noise. ``(1, action_dim)``
        """
        if not self._model.hand_actions:
            return disturbed
        action = (meant if self._waits else disturbed).clone()
        action[:, list(self._model.hand_actions)] = self._hand
        return action

    def _place(self, observation: torch.Tensor) -> torch.Tensor:
        return self._model.object_position(observation) if self._around is None else self._around

    def _follow(self, observation: torch.Tensor, generator: torch.Generator) -> None:
        """Begin the next leg where this one has ended."""
        if self._over:
            return
        if self._waits:
            self._waits -= 1
            return
        self._ticks += 1
        if self._around is not None:
            distance = apart(self._model.effector_position(observation), self._around)
            if distance < self._config.radius_m or self._ticks > LEG_TICKS:
                self._begin_leg(observation, generator, around=False)
            return
        least = self._config.again_m or self._config.touched_m
        if touched(self._model, self._before, observation, self._config.radius_m, least):
            self._over = self._config.again_m is None or _chance(self._config.hand_over, generator)
            if not self._over:
                around = _chance(self._config.around_share, generator)
                self._begin_leg(observation, generator, around=around)
