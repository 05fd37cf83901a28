"""The imaginary source: filled each cycle, cleared and refilled after each model update."""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import torch

from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.goal_model import IMAGINED, REAL, GoalModel, Shapes
from iher_robot.learning.imagination.dynamics import DIVERGED, DynamicsEnsemble
from iher_robot.learning.imagination.intrinsic import disagreement, intrinsic_reward
from iher_robot.learning.imagination.rollout import imagine
from iher_robot.learning.metrics import Meter
from iher_robot.learning.policy import Policy, explore
from iher_robot.learning.replay import EpisodeReplay, Transitions
from iher_robot.learning.symmetry import Symmetry, augment, choose_maps

Progress = Callable[[str, int, int], None]
"""Called with the phase's name, the steps done and their total."""

CHUNK = 4_000


class ImaginarySource:
    """Imagined episodes and the policies that imagine them.

    Args:
        shapes: Sizes of the arrays.
        goal_model: Goals to imagine, derived entries.
        config: Settings.
        real: Real episodes, where rollouts begin.
        generator: Every draw, on ``device``.
        device: Where the data live.
        symmetry: Maps to whose images of the real starts rollouts are moved; None for none.
    """

    def __init__(
        self,
        shapes: Shapes,
        goal_model: GoalModel,
        config: LearnerConfig,
        real: EpisodeReplay,
        *,
        generator: torch.Generator,
        device: torch.device,
        symmetry: Symmetry | None = None,
    ) -> None:
        ticks = config.imagination.branch_ticks or shapes.episode_ticks
        self.shapes = dataclasses.replace(shapes, episode_ticks=ticks)
        self.goal_model = goal_model
        self.config = config
        self.generator = generator
        self.device = device
        self._real = real
        self._symmetry = symmetry
        self.replay = EpisodeReplay(
            self.shapes, capacity=config.replay.capacity, source=IMAGINED, device=device
        )
        self.collected = 0
        self.level = 0
        self.policy_copies: deque[tuple[int, dict[str, Any]]] = deque(
            maxlen=1 + -(-self.replay.max_episodes // self.rollouts_per_policy)
        )

    @property
    def rollouts_per_policy(self) -> int:
        """Rollouts that each policy adds to a refill: C x I (paper, appendix)."""
        return self.config.schedule.cycles * self.config.schedule.imaginary_episodes

    def keep_copy(self, policy: Policy, cycle: int) -> None:
        """Keep a copy of the policy as it is after that many cycles, where a refill asks for it."""
        if not self._branches:
            self.policy_copies.append((cycle, policy.snapshot()))

    def imagine_cycle(
        self, ensemble: DynamicsEnsemble, policy: Policy, *, epoch: int
    ) -> dict[str, float]:
        """Add one cycle's rollouts of the current policy.

        Args:
            ensemble: The models.
            policy: The current policy.
            epoch: The current epoch.

        Returns:
            What the rollouts show.

        Raises:
            FloatingPointError: No rollout is finite, now and before.
        """
        count = self.config.schedule.imaginary_episodes
        report = self.add_rollouts(ensemble, policy, count, epoch=epoch)
        self._require_rollouts()
        self.collected += int(report.pop("kept")) * self.shapes.episode_ticks
        self.level = self.replay.num_transitions
        return report

    def refill(
        self,
        ensemble: DynamicsEnsemble,
        policy: Policy,
        *,
        epoch: int,
        cycle: int,
        progress: Progress,
    ) -> dict[str, float]:
        """Clear the source and refill it to its level with the newest models only.

        The current policy first, then its copies from the newest to the oldest, each with C x I
        rollouts (paper, appendix), or with an equal share where too few copies exist. Branches
        are cleared and not refilled: the next cycle's are soon as many as a batch takes.

        Args:
            ensemble: The models.
            policy: The current policy.
            epoch: The current epoch.
            cycle: Cycles so far; a copy of that cycle equals the current policy.
            progress: Told how far the refill is.

        Returns:
            What the rollouts show.

        Raises:
            FloatingPointError: No rollout is finite.
        """
        self.replay.clear()
        if self._branches:
            return {}
        policies = [policy, *self._older_policies(cycle, policy.products)]
        share = max(self.rollouts_per_policy, -(-self._missing() // len(policies)))
        meter = Meter()
        while self._missing():
            for each in policies:
                wanted = min(share, self._missing())
                for start in range(0, wanted, CHUNK):
                    count = min(CHUNK, wanted - start)
                    meter.add(self.add_rollouts(ensemble, each, count, epoch=epoch))
                    progress("imagine", self.replay.num_transitions, self.level)
            self._require_rollouts()
        report = meter.means()
        report.pop("kept", None)
        return report

    def _require_rollouts(self) -> None:
        # Not those of one call: it may want so few that all of them are dropped by chance.
        if self.replay.num_episodes == 0:
            raise FloatingPointError(
                f"every imagined rollout held a value that is not finite: {DIVERGED}"
            )

    def _missing(self) -> int:
        """Episodes that are missing to the source's level."""
        return -(-(self.level - self.replay.num_transitions) // self.shapes.episode_ticks)

    def _older_policies(self, cycle: int, products: torch.dtype) -> Iterator[Policy]:
        for copied_at, snapshot in reversed(self.policy_copies):
            if copied_at != cycle:
                yield Policy.from_snapshot(snapshot, device=self.device, products=products)

    def add_rollouts(
        self,
        ensemble: DynamicsEnsemble,
        policy: Policy,
        count: int,
        *,
        epoch: int,
    ) -> dict[str, float]:
        """Add rollouts of a policy.

        Args:
            ensemble: The models.
            policy: The policy, here with exploration.
            count: Rollouts to add; with ``keep`` more are imagined.
            epoch: The current epoch.

        Returns:
            What they show; ``kept`` is the number that were added.
        """
        keep = count
        count = math.ceil(count / self.config.imagination.keep)
        start, goals = self._starts(count)
        flip = torch.rand(count, generator=self.generator, device=self.device)
        source = torch.where(flip < self.config.exploration.source_flip, REAL, IMAGINED)

        def act(observation: torch.Tensor) -> torch.Tensor:
            action = policy.act(observation, goals, source)
            return explore(action, self.config.exploration, self.generator)

        rollouts = imagine(
            ensemble,
            self.goal_model,
            start=start,
            goals=goals,
            act=act,
            ticks=self.shapes.episode_ticks,
            state_margin=self.config.imagination.state_margin,
            spread=self._disagreement,
            generator=self.generator,
        )
        finite = len(rollouts.actions)
        agreed = rollouts.spreads.mean(dim=1).argsort()
        agreed = agreed[:keep].sort().values
        reward = torch.zeros_like(rollouts.spreads)
        if self.config.intrinsic.enabled:
            reward = intrinsic_reward(rollouts.spreads, self.config.intrinsic)
        if finite:
            self.replay.add(
                rollouts.observations[agreed],
                rollouts.actions[agreed],
                rollouts.goals[agreed],
                epoch=epoch,
                intrinsic=reward[agreed],
            )
        clipped = reward >= self.config.intrinsic.clip
        return {
            "kept": len(agreed),
            "imagined_dropped": rollouts.dropped / count,
            "intrinsic_imagined": float(reward.mean()) if finite else 0.0,
            "intrinsic_clipped": float(clipped.float().mean()) if finite else 0.0,
        }

    def _disagreement(self, predictions: torch.Tensor) -> torch.Tensor:
        if not self.config.intrinsic.enabled and self.config.imagination.keep == 1.0:
            return predictions.new_zeros(predictions.shape[1])
        return disagreement(predictions, self.config.intrinsic)

    def _starts(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Observations to begin at, and goals. ``(count, obs_dim)``, ``(count, goal_dim)``"""
        if self._branches:
            fraction = self.config.replay.future_fraction
            drawn = self._real.sample(
                count, self.generator, self.goal_model, future_fraction=fraction
            )
            drawn = augment(drawn, self._symmetry, self.generator)
            return drawn.observation, drawn.goal
        starts = self._real.start_observations()
        row = torch.randint(len(starts), (count,), generator=self.generator, device=self.device)
        start = starts[row]
        if self._symmetry is not None:
            start = choose_maps(self._symmetry, start, start, self.generator).observation(start)
        return start, self._sample_goals(start)

    def sample(self, count: int) -> Transitions:
        """Draw imagined transitions with their goals.

        Args:
            count: How many.

        Returns:
            The batch. Whole episodes are relabelled as real ones are; branches came with goals
            from the whole of a real episode, and hindsight within them would be trivial.
        """
        fraction = 0.0 if self._branches else self.config.replay.future_fraction
        return self.replay.sample(count, self.generator, self.goal_model, future_fraction=fraction)

    @property
    def _branches(self) -> bool:
        return self.config.imagination.branch_ticks is not None

    def _sample_goals(self, start: torch.Tensor) -> torch.Tensor:
        # The task draws with NumPy; one number of the learner's stream seeds it.
        seed = int(torch.randint(2**62, (), generator=self.generator, device=self.device))
        goals = self.goal_model.sample_goal(np.random.default_rng(seed), start.cpu().numpy())
        return torch.as_tensor(goals, dtype=torch.float32, device=self.device)

    def state_dict(self) -> dict[str, Any]:
        """Counters and policy copies; and the imagined data, unless each epoch makes them anew."""
        state = {
            "collected": self.collected,
            "level": self.level,
            "policy_copies": list(self.policy_copies),
        }
        if not self.config.imagination.regenerate:
            state["replay"] = self.replay.state_dict()
        return state

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what ``state_dict`` returned; ``refill`` brings data back that it has not."""
        self.replay.clear()
        if "replay" in state:
            self.replay.load_state_dict(state["replay"])
        self.collected = state["collected"]
        self.level = state["level"]
        self.policy_copies.clear()
        self.policy_copies.extend((cycle, snapshot) for cycle, snapshot in state["policy_copies"])
