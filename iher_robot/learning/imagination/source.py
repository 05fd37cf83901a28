"""The imaginary source: filled each cycle, cleared and refilled after each model update."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import torch

from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.exploration import explore
from iher_robot.learning.goal_model import IMAGINED, REAL, GoalModel, Shapes
from iher_robot.learning.imagination.dynamics import DIVERGED, DynamicsEnsemble
from iher_robot.learning.imagination.intrinsic import disagreement, intrinsic_reward
from iher_robot.learning.imagination.policy_copies import PolicyCopies
from iher_robot.learning.imagination.rollout import ImaginedRollouts, imagine
from iher_robot.learning.imagination.starts import StartStates
from iher_robot.learning.metrics import Meter
from iher_robot.learning.policy import Policy
from iher_robot.learning.progress import Progress
from iher_robot.learning.replay import EpisodeReplay
from iher_robot.learning.symmetry import Symmetry, augment
from iher_robot.learning.transitions import Transitions

CHUNK = 4_000
"""Most rollouts that a refill imagines at once."""


class ImaginarySource:
    """Imagined episodes, and the policies that refill them.

    Args:
        shapes: Sizes of the arrays.
        goal_model: Goals to imagine, derived entries.
        config: Settings.
        real: Real episodes, where rollouts begin.
        generator: Source of randomness, on ``device``.
        device: Where the data live.
        symmetry: Maps whose images rollouts start from and are sampled as; None for none.

    Attributes:
        replay: The stored rollouts.
        collected: Transitions of all cycles; refills add none.
        level: Transitions that a refill restores.
        policy_copies: Earlier policies.
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
        self._symmetry = symmetry
        self._branches = config.imagination.branch_ticks is not None
        self._starts = StartStates(real, goal_model, config, generator=generator, symmetry=symmetry)
        self.replay = EpisodeReplay(
            self.shapes, capacity=config.replay.capacity, source=IMAGINED, device=device
        )
        self.collected = 0
        self.level = 0
        refill_policies = math.ceil(self.replay.max_episodes / self.rollouts_per_policy)
        # One more: the newest copy may equal the current policy.
        self.policy_copies = PolicyCopies(1 + refill_policies, device)

    @property
    def rollouts_per_policy(self) -> int:
        """Rollouts that each policy adds to a refill: C x I (paper, appendix)."""
        return self.config.schedule.cycles * self.config.schedule.imaginary_episodes

    def keep_copy(self, policy: Policy, cycle: int) -> None:
        """Keep a copy of the policy as it is after that cycle, unless refills need none."""
        if not self._branches:
            self.policy_copies.add(policy, cycle)

    def imagine_cycle(
        self, ensemble: DynamicsEnsemble, policy: Policy, *, epoch: int
    ) -> dict[str, float]:
        """Add one cycle's rollouts of the current policy.

        Args:
            ensemble: The models.
            policy: The current policy.
            epoch: The current epoch.

        Returns:
            Metrics of the rollouts.

        Raises:
            FloatingPointError: The source is empty, because no rollout was finite.
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
        rollouts (paper, appendix), or with an equal share if there are too few copies. Branches
        are cleared and not refilled: a few cycles bring as many as a batch takes.

        Args:
            ensemble: The models.
            policy: The current policy.
            epoch: The current epoch.
            cycle: Cycles so far; a copy of that cycle equals the current policy.
            progress: Called after each chunk.

        Returns:
            Metrics of the rollouts.

        Raises:
            FloatingPointError: No rollout is finite.
        """
        self.replay.clear()
        if self._branches:
            return {}
        policies = [policy, *self.policy_copies.older_than(cycle, policy.matmul_dtype)]
        share = max(self.rollouts_per_policy, math.ceil(self._missing() / len(policies)))
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
        # Not checked for each call: all of a few rollouts may be dropped by chance.
        if self.replay.num_episodes == 0:
            raise FloatingPointError(
                f"every imagined rollout held a value that is not finite: {DIVERGED}"
            )

    def _missing(self) -> int:
        """Episodes below the source's level."""
        missing = self.level - self.replay.num_transitions
        return math.ceil(missing / self.shapes.episode_ticks)

    def add_rollouts(
        self, ensemble: DynamicsEnsemble, policy: Policy, count: int, *, epoch: int
    ) -> dict[str, float]:
        """Add rollouts of a policy.

        Args:
            ensemble: The models.
            policy: The policy, which acts with exploration.
            count: Rollouts to add; with ``imagination.keep`` below 1 more are imagined.
            epoch: The current epoch.

        Returns:
            Metrics of the rollouts; ``kept`` is the number that were added.
        """
        imagined = math.ceil(count / self.config.imagination.keep)
        rollouts = self._rollouts(ensemble, policy, imagined)
        reward = torch.zeros_like(rollouts.spreads)
        if self.config.intrinsic.enabled:
            reward = intrinsic_reward(rollouts.spreads, self.config.intrinsic)
        finite = len(rollouts.actions)
        # Those on which the models agree best, in the order in which they were imagined.
        kept = rollouts.spreads.mean(dim=1).argsort()[:count].sort().values
        if finite:
            self.replay.add(
                rollouts.observations[kept],
                rollouts.actions[kept],
                rollouts.goals[kept],
                epoch=epoch,
                intrinsic=reward[kept],
            )
        clipped = reward >= self.config.intrinsic.clip
        return {
            "kept": len(kept),
            "imagined_dropped": rollouts.dropped / imagined,
            "intrinsic_imagined": float(reward.mean()) if finite else 0.0,
            "intrinsic_clipped": float(clipped.float().mean()) if finite else 0.0,
        }

    def _rollouts(self, ensemble: DynamicsEnsemble, policy: Policy, count: int) -> ImaginedRollouts:
        start, goals = self._starts.draw(count)
        flip = torch.rand(count, generator=self.generator, device=self.device)
        source = torch.where(flip < self.config.exploration.source_flip, REAL, IMAGINED)

        def act(observation: torch.Tensor) -> torch.Tensor:
            action = policy.act(observation, goals, source)
            return explore(action, self.config.exploration, self.generator)

        return imagine(
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

    def _disagreement(self, predictions: torch.Tensor) -> torch.Tensor:
        if not self.config.intrinsic.enabled and self.config.imagination.keep == 1.0:
            return predictions.new_zeros(predictions.shape[1])
        return disagreement(predictions, self.config.intrinsic)

    def sample(self, count: int) -> Transitions:
        """Sample imagined transitions, or their images where a symmetry is used.

        Whole episodes are relabelled like real ones. Branches are not: their goals come from the
        whole of a real episode, and hindsight within so few ticks would be trivial.

        Args:
            count: Transitions, drawn with replacement.
        """
        fraction = 0.0 if self._branches else self.config.replay.future_fraction
        batch = self.replay.sample(count, self.generator, self.goal_model, future_fraction=fraction)
        return augment(batch, self._symmetry, self.generator)

    def state_dict(self) -> dict[str, Any]:
        """Counters and policy copies; imagined data only if they are not regenerated."""
        state = {
            "collected": self.collected,
            "level": self.level,
            "policy_copies": self.policy_copies.state(),
        }
        if not self.config.imagination.regenerate:
            state["replay"] = self.replay.state_dict()
        return state

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what ``state_dict`` returned; ``refill`` restores regenerated data."""
        self.replay.clear()
        if "replay" in state:
            self.replay.load_state_dict(state["replay"])
        self.collected = state["collected"]
        self.level = state["level"]
        self.policy_copies.load_state(state["policy_copies"])
