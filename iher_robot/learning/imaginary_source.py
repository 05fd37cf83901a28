"""The imaginary source: filled each cycle, cleared and refilled after each model update."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import torch

from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.dynamics import DIVERGED, DynamicsEnsemble
from iher_robot.learning.goal_model import IMAGINED, REAL, GoalModel, Shapes
from iher_robot.learning.imagination import imagine
from iher_robot.learning.intrinsic import disagreement, intrinsic_reward
from iher_robot.learning.meter import Meter
from iher_robot.learning.policy import Policy, explore
from iher_robot.learning.replay import EpisodeReplay

Progress = Callable[[str, int, int], None]
"""Called with the phase's name, the steps done and their total."""

CHUNK = 4_000


class ImaginarySource:
    """Imagined episodes and the policies that imagine them.

    Args:
        shapes: Sizes of the arrays.
        goal_model: Goals to imagine, derived entries.
        config: Settings.
        generator: Every draw, on ``device``.
        device: Where the data live.
    """

    def __init__(
        self,
        shapes: Shapes,
        goal_model: GoalModel,
        config: LearnerConfig,
        *,
        generator: torch.Generator,
        device: torch.device,
    ) -> None:
        self.shapes = shapes
        self.goal_model = goal_model
        self.config = config
        self.generator = generator
        self.device = device
        self.replay = EpisodeReplay(
            shapes, capacity=config.replay.capacity, source=IMAGINED, device=device
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
        """Keep a copy of the policy as it is after that many cycles."""
        self.policy_copies.append((cycle, policy.snapshot()))

    def imagine_cycle(
        self, ensemble: DynamicsEnsemble, policy: Policy, starts: torch.Tensor, *, epoch: int
    ) -> dict[str, float]:
        """Add one cycle's rollouts of the current policy.

        Args:
            ensemble: The models.
            policy: The current policy.
            starts: Real observations to start from. ``(starts, obs_dim)``
            epoch: The current epoch.

        Returns:
            What the rollouts show.

        Raises:
            FloatingPointError: No rollout is finite, now and before.
        """
        count = self.config.schedule.imaginary_episodes
        report = self.add_rollouts(ensemble, policy, starts, count, epoch=epoch)
        self._require_rollouts()
        self.collected += int(report.pop("kept")) * self.shapes.episode_ticks
        self.level = self.replay.num_transitions
        return report

    def refill(
        self,
        ensemble: DynamicsEnsemble,
        policy: Policy,
        starts: torch.Tensor,
        *,
        epoch: int,
        cycle: int,
        progress: Progress,
    ) -> dict[str, float]:
        """Clear the source and refill it to its level with the newest models only.

        The current policy first, then its copies from the newest to the oldest, each with C x I
        rollouts (paper, appendix), or with an equal share where too few copies exist.

        Args:
            ensemble: The models.
            policy: The current policy.
            starts: Real observations to start from. ``(starts, obs_dim)``
            epoch: The current epoch.
            cycle: Cycles so far; a copy of that cycle equals the current policy.
            progress: Told how far the refill is.

        Returns:
            What the rollouts show.

        Raises:
            FloatingPointError: No rollout is finite.
        """
        self.replay.clear()
        policies = [policy, *self._older_policies(cycle)]
        share = max(self.rollouts_per_policy, -(-self._missing() // len(policies)))
        meter = Meter()
        while self._missing():
            for each in policies:
                wanted = min(share, self._missing())
                for start in range(0, wanted, CHUNK):
                    count = min(CHUNK, wanted - start)
                    meter.add(self.add_rollouts(ensemble, each, starts, count, epoch=epoch))
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

    def _older_policies(self, cycle: int) -> Iterator[Policy]:
        for copied_at, snapshot in reversed(self.policy_copies):
            if copied_at != cycle:
                yield Policy.from_snapshot(snapshot, device=self.device)

    def add_rollouts(
        self,
        ensemble: DynamicsEnsemble,
        policy: Policy,
        starts: torch.Tensor,
        count: int,
        *,
        epoch: int,
    ) -> dict[str, float]:
        """Add rollouts of a policy.

        Args:
            ensemble: The models.
            policy: The policy, here with exploration.
            starts: Real observations to start from. ``(starts, obs_dim)``
            count: Rollouts to imagine.
            epoch: The current epoch.

        Returns:
            What they show; ``kept`` is the number that were finite.
        """
        row = torch.randint(len(starts), (count,), generator=self.generator, device=self.device)
        start = starts[row]
        flip = torch.rand(count, generator=self.generator, device=self.device)
        source = torch.where(flip < self.config.exploration.source_flip, REAL, IMAGINED)
        goals = self._sample_goals(start)

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
            spread=self._intrinsic,
            generator=self.generator,
        )
        kept = len(rollouts.actions)
        if kept:
            self.replay.add(
                rollouts.observations,
                rollouts.actions,
                rollouts.goals,
                epoch=epoch,
                intrinsic=rollouts.spreads,
            )
        clipped = rollouts.spreads >= self.config.intrinsic.clip
        return {
            "kept": kept,
            "imagined_dropped": rollouts.dropped / count,
            "intrinsic_imagined": float(rollouts.spreads.mean()) if kept else 0.0,
            "intrinsic_clipped": float(clipped.float().mean()) if kept else 0.0,
        }

    def _intrinsic(self, predictions: torch.Tensor) -> torch.Tensor:
        if not self.config.intrinsic.enabled:
            return predictions.new_zeros(predictions.shape[1])
        sigma = disagreement(predictions, self.config.intrinsic)
        return intrinsic_reward(sigma, self.config.intrinsic)

    def _sample_goals(self, start: torch.Tensor) -> torch.Tensor:
        # The task draws with NumPy; one number of the learner's stream seeds it.
        seed = int(torch.randint(2**62, (), generator=self.generator, device=self.device))
        goals = self.goal_model.sample_goal(np.random.default_rng(seed), start.cpu().numpy())
        return torch.as_tensor(goals, dtype=torch.float32, device=self.device)

    def state_dict(self) -> dict[str, Any]:
        """Counters and policy copies; the imagined data are refilled, never stored."""
        return {
            "collected": self.collected,
            "level": self.level,
            "policy_copies": list(self.policy_copies),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what ``state_dict`` returned; ``refill`` brings the data back."""
        self.replay.clear()
        self.collected = state["collected"]
        self.level = state["level"]
        self.policy_copies.clear()
        self.policy_copies.extend((cycle, snapshot) for cycle, snapshot in state["policy_copies"])
