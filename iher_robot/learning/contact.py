"""Contact first: a second policy that brings the effector to the object, for exploration."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import torch

from iher_robot.learning.config import ContactConfig, LearnerConfig
from iher_robot.learning.ddpg import DDPG
from iher_robot.learning.episode import Episode
from iher_robot.learning.goal_model import REAL, Array, Shapes
from iher_robot.learning.meter import Meter
from iher_robot.learning.policy import Policy
from iher_robot.learning.replay import EpisodeReplay
from iher_robot.learning.symmetry import Symmetry, augment

BLOCK = 40
"""Updates whose batches are drawn together."""
LEG_TICKS = 15
"""Ticks after which a point around the object that was not reached is given up."""
TOUCH_WINDOW = 20
"""Newest episodes that decide whether the object is touched often enough."""


class ContactModel(Protocol):
    """Where effector and object are, which the task declares. Batched over leading axes."""

    @property
    def effector_entries(self) -> tuple[int, ...]:
        """Entries of the observation with the position of the end effector."""

    @property
    def hand_actions(self) -> tuple[int, ...]:
        """Entries of the action that open a hand, at 1, and close it, at -1; empty without one."""

    def effector_position(self, observation: torch.Tensor, /) -> torch.Tensor:
        """Position of the end effector, m. ``(..., obs_dim) -> (..., 3)``"""

    def object_position(self, observation: torch.Tensor, /) -> torch.Tensor:
        """Position of the object, m. ``(..., obs_dim) -> (..., 3)``"""


def _apart(one: torch.Tensor, other: torch.Tensor) -> float:
    return float(torch.linalg.vector_norm(one - other, dim=-1).amin())


def touched(
    model: ContactModel,
    start: torch.Tensor,
    observation: torch.Tensor,
    radius_m: float,
    moved_m: float,
) -> bool:
    """Whether the object was touched in some of the observations.

    Args:
        model: Where effector and object are.
        start: Where the object was before, m. ``(1, 3)``
        observation: ``(ticks, obs_dim)``
        radius_m: It was if the effector came so near, m,
        moved_m: or if it moved by this much, m.
    """
    moved = torch.linalg.vector_norm(model.object_position(observation) - start, dim=-1)
    return bool(((gap(model, observation) < radius_m) | (moved > moved_m)).any())


def gap(model: ContactModel, observation: torch.Tensor) -> torch.Tensor:
    """Distance from effector to object, m. ``(..., obs_dim) -> (...,)``"""
    between = model.effector_position(observation) - model.object_position(observation)
    distance: torch.Tensor = torch.linalg.vector_norm(between, dim=-1)
    return distance


class EffectorGoals:
    """Goal model of the second policy: the effector's position is the goal it achieves."""

    def __init__(self, model: ContactModel, radius_m: float) -> None:
        self._model = model
        self._radius_m = radius_m

    def achieved_goal(self, observation: torch.Tensor, /) -> torch.Tensor:
        """Position of the effector, m. ``(..., obs_dim) -> (..., 3)``"""
        return self._model.effector_position(observation)

    def compute_reward(self, achieved: torch.Tensor, desired: torch.Tensor, /) -> torch.Tensor:
        """0 within the radius, else -1. ``(..., 3) -> (...,)``"""
        distance: torch.Tensor = torch.linalg.vector_norm(achieved - desired, dim=-1)
        return -(distance > self._radius_m).float()

    def complete(self, observation: torch.Tensor, /) -> torch.Tensor:
        """Nothing is imagined with these goals. ``(..., obs_dim)``"""
        return observation

    def tightened(self, share: float, /) -> EffectorGoals:
        """The same goals within a share of the radius."""
        return EffectorGoals(self._model, share * self._radius_m)

    def sample_goal(self, rng: np.random.Generator, start_observation: Array, /) -> Array:
        """Refuse: every goal of this policy is an object or hindsight."""
        raise NotImplementedError


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

    def begin(self, observation: torch.Tensor, generator: torch.Generator) -> Play | None:
        """Begin an episode; None where this policy has no part in it.

        Args:
            observation: Where it begins. ``(1, obs_dim)``
            generator: Draws whether it has.
        """
        if self._rests and torch.rand((), generator=generator) >= self._config.episodes:
            return None
        return Play(self, self._model, self._config, observation, generator)

    def act(self, observation: torch.Tensor, place: torch.Tensor) -> torch.Tensor:
        """Action towards a place, without noise. ``(1, obs_dim), (1, 3) -> (1, action_dim)``"""
        source = torch.full((len(observation),), REAL)
        return self._policy.act(observation, place, source)


class Play:
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
        self._begin_leg(start, generator, around=self._draws_around(generator))
        self._waits = 0

    def _draws_around(self, generator: torch.Generator) -> bool:
        return bool(torch.rand((), generator=generator) < self._config.around_share)

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
        if self._over or torch.rand((), generator=generator) >= self._config.share:
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
            apart = _apart(self._model.effector_position(observation), self._around)
            if apart < self._config.radius_m or self._ticks > LEG_TICKS:
                self._begin_leg(observation, generator, around=False)
            return
        least = self._config.again_m or self._config.touched_m
        if touched(self._model, self._before, observation, self._config.radius_m, least):
            self._over = self._config.again_m is None or self._hands_over(generator)
            if not self._over:
                self._begin_leg(observation, generator, around=self._draws_around(generator))

    def _hands_over(self, generator: torch.Generator) -> bool:
        return bool(torch.rand((), generator=generator) < self._config.hand_over)


class ContactLearner:
    """Trains the second policy on the real data, with positions of the effector as hindsight.

    Args:
        shapes: Sizes of the task's arrays.
        model: Where effector and object are.
        config: Settings of the learner; but for the networks' widths and the number of critics the
            optimisation is that of the main policy.
        seed: Seeds every draw.
        device: Where it computes.

    Attributes:
        rests: Whether the object was touched often enough for it to be left as it is.
    """

    def __init__(
        self,
        shapes: Shapes,
        model: ContactModel,
        config: LearnerConfig,
        *,
        seed: int,
        device: torch.device,
    ) -> None:
        self.config = config
        self.model = model
        self.goals = EffectorGoals(model, config.contact.radius_m)
        own = config.model_copy(
            update={
                "ddpg": config.ddpg.model_copy(
                    update={
                        "hidden": config.contact.hidden,
                        "critics": 1,
                        "target_subset": 1,
                        "policy_average": None,
                        "source_input": False,
                        "component_critics": False,
                        "target_update": "update",
                    }
                ),
            }
        )
        entries = model.effector_entries
        shapes = dataclasses.replace(shapes, goal_dim=len(entries), goal_entries=entries)
        initial = torch.Generator().manual_seed(seed)
        self.policy = Policy.from_config(shapes, own, generator=initial, device=device)
        self.ddpg = DDPG(self.policy, shapes, own, generator=initial, device=device)
        self.generator = torch.Generator(device).manual_seed(seed)
        self._touched: deque[bool] = deque(maxlen=TOUCH_WINDOW)
        self.rests = False

    def add_real(self, fresh: EpisodeReplay, episodes: Sequence[Episode]) -> None:
        """Take in an epoch's episodes, unless it rests.

        Args:
            fresh: Their transitions.
            episodes: The episodes.
        """
        if self.rests:
            return
        batch = fresh.sample(fresh.num_transitions, self.generator, self.goals, future_fraction=1.0)
        self.policy.update_normalizers(batch.observation, batch.goal)
        self._touched.extend(self.touched(episode) for episode in episodes)
        often = float(np.mean(self._touched)) >= self.config.contact.until_touched
        self.rests = often and len(self._touched) == TOUCH_WINDOW

    def touched(self, episode: Episode) -> bool:
        """Whether the effector came to the object."""
        observations = torch.as_tensor(episode.observations)
        start = self.model.object_position(observations[:1])
        contact = self.config.contact
        return touched(self.model, start, observations, contact.radius_m, contact.touched_m)

    def learn(self, real: EpisodeReplay, updates: int, symmetry: Symmetry | None) -> Meter:
        """Take gradient steps, unless it rests.

        Args:
            real: All real data.
            updates: How many steps.
            symmetry: The task's, if it is used.

        Returns:
            What they report.
        """
        meter = Meter()
        if self.rests:
            return meter
        size = self.config.schedule.workers * self.config.ddpg.batch_size
        for done in range(0, updates, BLOCK):
            batches = min(BLOCK, updates - done)
            drawn = real.sample(batches * size, self.generator, self.goals, future_fraction=1.0)
            # The curiosity that is stored with the data is not this policy's.
            drawn = dataclasses.replace(drawn, intrinsic=torch.zeros_like(drawn.intrinsic))
            for batch in augment(drawn, symmetry, self.generator).split(batches):
                report = self.ddpg.update(batch)
                meter.add({"contact_critic_loss": report["critic_loss"]})
        return meter

    def state_dict(self) -> dict[str, Any]:
        """All that ``load_state_dict`` needs: tensors and scalars."""
        return {
            "policy": self.policy.snapshot(),
            "ddpg": self.ddpg.state_dict(),
            "generator": self.generator.get_state(),
            "touched": list(self._touched),
            "rests": self.rests,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what ``state_dict`` returned."""
        self.policy.load_snapshot(state["policy"])
        self.ddpg.load_state_dict(state["ddpg"])
        self.generator.set_state(state["generator"].cpu())
        self._touched.clear()
        self._touched.extend(state["touched"])
        self.rests = state["rests"]

    def snapshot(self, device: torch.device) -> ContactPolicy:
        """Copy of the policy, for an actor. It is independent of later updates."""
        policy = Policy.from_snapshot(self.policy.snapshot(), device=device)
        return ContactPolicy(policy, self.model, self.config.contact, rests=self.rests)
