"""The I-HER learner: Algorithm 1 of the paper, without the collection of real episodes."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import Any

import torch

from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.contact.learner import ContactLearner
from iher_robot.learning.contact.model import ContactModel
from iher_robot.learning.ddpg import DDPG
from iher_robot.learning.episode import Episode
from iher_robot.learning.exploration import Explorer
from iher_robot.learning.goal_model import GoalModel, Shapes
from iher_robot.learning.imagination.dynamics import DynamicsEnsemble
from iher_robot.learning.imagination.intrinsic import refresh_intrinsic
from iher_robot.learning.imagination.source import ImaginarySource
from iher_robot.learning.metrics import Meter
from iher_robot.learning.networks.data_parallel import ALONE, Peers
from iher_robot.learning.policy import Policy
from iher_robot.learning.progress import Progress, silent
from iher_robot.learning.real_source import RealSource
from iher_robot.learning.symmetry import Symmetry
from iher_robot.learning.transitions import BLOCK, Transitions
from iher_robot.learning.validation import validate

DYNAMICS_CHUNK = 25
"""Gradient steps of the models between two reports of progress."""


class Learner:
    """Learns a goal-conditioned policy from real and imagined episodes.

    One epoch, where ``collect`` is the actor's::

        episodes = collect(learner.acting_policy(device), learner.explorer())
        learner.add_real(episodes)
        metrics = learner.learn()

    Args:
        shapes: Sizes of the arrays.
        goal_model: Achieved goals, rewards, goals to imagine.
        config: Settings.
        seed: Seeds every draw of the learner.
        device: Where replay, models and policy live.
        symmetry: Maps that leave the task unchanged, for ``config.symmetry``.
        contact_model: Positions of effector and object, for ``config.contact``.
        peers: Learners in other processes with the same settings, seed and real episodes; each
            computes on its shard of every batch, and their weights stay equal.

    Raises:
        ValueError: A setting needs what the task does not declare, or a batch does not divide into
            equal shards.
    """

    def __init__(
        self,
        shapes: Shapes,
        goal_model: GoalModel,
        config: LearnerConfig,
        *,
        seed: int,
        device: torch.device,
        symmetry: Symmetry | None = None,
        contact_model: ContactModel | None = None,
        peers: Peers = ALONE,
    ) -> None:
        validate(config, shapes, symmetry, contact_model, peers)
        self.shapes = shapes
        self.goal_model = goal_model
        self.config = config
        self.device = device
        self.epoch = self.cycle = self.updates = 0
        self.generator = torch.Generator(device).manual_seed(seed)
        self._symmetry = symmetry if config.symmetry.enabled else None
        initial = torch.Generator().manual_seed(seed)
        self.policy = Policy.from_config(shapes, config, generator=initial, device=device)
        self.ddpg = DDPG(self.policy, shapes, config, generator=initial, device=device, peers=peers)
        self.ensemble = self._new_ensemble(initial, peers)
        self.real, self.imagined = self._new_sources()
        self.contact: ContactLearner | None = None
        if config.contact.enabled and contact_model is not None:
            self.contact = ContactLearner(
                shapes, contact_model, config, seed=seed, device=device, peers=peers
            )

    def _new_ensemble(self, initial: torch.Generator, peers: Peers) -> DynamicsEnsemble:
        return DynamicsEnsemble(
            self.shapes,
            self.config.dynamics,
            generator=initial,
            device=self.device,
            symmetry=self._symmetry,
            matmul_dtype=self.policy.matmul_dtype,
            peers=peers,
        )

    def _new_sources(self) -> tuple[RealSource, ImaginarySource]:
        goals = self.goal_model.tightened(self.config.replay.tolerance)
        real = RealSource(
            self.shapes,
            goals,
            self.config.replay,
            generator=self.generator,
            device=self.device,
            symmetry=self._symmetry,
        )
        imagined = ImaginarySource(
            self.shapes,
            goals,
            self.config,
            real.replay,
            generator=self.generator,
            device=self.device,
            symmetry=self._symmetry,
        )
        return real, imagined

    def acting_policy(self, device: torch.device) -> Policy:
        """Copy of the policy that acts, independent of later updates.

        Args:
            device: Where the actor computes.
        """
        return Policy.from_snapshot(self.ddpg.acting_snapshot(), device=device)

    def explorer(self) -> Explorer:
        """Exploration of an actor on the CPU, independent of later updates."""
        contact = None if self.contact is None else self.contact.snapshot(torch.device("cpu"))
        return Explorer(self.config.exploration, contact)

    def add_real(self, episodes: Sequence[Episode]) -> None:
        """Begin an epoch with its real episodes (Algorithm 1, line 5).

        Args:
            episodes: Episodes of this epoch. Invalid ticks are left out, and no transition or
                hindsight goal spans one.
        """
        self.epoch += 1
        segments = self.real.add(episodes, epoch=self.epoch)
        if segments:
            fresh = self.real.replay_of(segments, epoch=self.epoch)
            sample = self.real.sample(fresh.num_transitions, fresh)
            self.policy.update_normalizers(sample.observation, sample.goal)
            if self.contact is not None:
                self.contact.add_real(fresh, episodes)

    def learn(self, progress: Progress = silent) -> dict[str, float]:
        """Run the rest of the epoch: models, imagination and policy updates.

        Args:
            progress: Called as each phase advances.

        Returns:
            Metrics of the epoch.

        Raises:
            ValueError: No real transition has been added.
            FloatingPointError: The dynamics models diverged.
        """
        if self.real.replay.num_episodes == 0:
            raise ValueError("cannot learn: no real transition has been added; call add_real first")
        meter = Meter()
        if self.config.imagination.enabled:
            self._train_models(meter, progress)
            self._refill(meter, progress)
        if self.contact is not None:
            updates = max(1, round(self.config.contact.updates_per_step * self.real.fresh))
            meter.add(self.contact.learn(self.real.replay, updates, self._symmetry).means())
        updates_per_second = self._run_cycles(meter, progress)
        return meter.means() | {
            "epoch": self.epoch,
            "updates": self.updates,
            "updates_per_second": updates_per_second,
            "real_transitions": self.real.collected,
            "imagined_transitions": self.imagined.collected,
            "imagined_stored": self.imagined.level,
            "imagined_share": self.imagined_share,
        }

    def _train_models(self, meter: Meter, progress: Progress) -> None:
        """Train the ensemble on the real data (Algorithm 1, line 6)."""
        schedule = self.config.schedule
        steps = schedule.dynamics_steps
        if self.epoch == 1:
            steps *= schedule.first_epoch_dynamics_factor
        batch_size = schedule.workers * self.config.dynamics.batch_size
        real = self.real.replay
        self.ensemble.fit_normalizers(real, self.generator)
        for done in range(0, steps, DYNAMICS_CHUNK):
            chunk = min(DYNAMICS_CHUNK, steps - done)
            loss = self.ensemble.train(real, chunk, batch_size=batch_size, generator=self.generator)
            progress("dynamics", done + chunk, steps)
        meter.add({"dynamics_loss": loss})
        if self.config.intrinsic.enabled:
            reward = refresh_intrinsic(real, self.ensemble, self.config.intrinsic)
            meter.add({"intrinsic_real": reward.mean()})
            if not self.config.imagination.regenerate and self.imagined.replay.num_episodes:
                refresh_intrinsic(self.imagined.replay, self.ensemble, self.config.intrinsic)

    def _refill(self, meter: Meter, progress: Progress) -> None:
        """Clear the imaginary source and refill it with the new models (Algorithm 1, line 7)."""
        if self.config.imagination.regenerate or self.imagined.replay.num_episodes == 0:
            report = self.imagined.refill(
                self.ensemble, self.policy, epoch=self.epoch, cycle=self.cycle, progress=progress
            )
            meter.add(report)

    def _run_cycles(self, meter: Meter, progress: Progress) -> float:
        """Imagine and update in turn (Algorithm 1, lines 8 to 17); returns updates a second."""
        schedule, imagination = self.config.schedule, self.config.imagination.enabled
        started = time.perf_counter()
        updates = self._updates_of_epoch()
        for done in range(0, updates, schedule.batches):
            if imagination:
                meter.add(self.imagined.imagine_cycle(self.ensemble, self.policy, epoch=self.epoch))
            batches = min(schedule.batches, updates - done)
            self._update(batches, meter)
            self.ddpg.end_cycle()
            self.cycle += 1
            if imagination and self.cycle % schedule.policy_copy_cycles == 0:
                self.imagined.keep_copy(self.policy, self.cycle)
            progress("update", done + batches, updates)
        return updates / (time.perf_counter() - started)

    def _updates_of_epoch(self) -> int:
        schedule = self.config.schedule
        if schedule.updates_per_step is None:
            return schedule.cycles * schedule.batches
        return max(1, round(schedule.updates_per_step * self.real.fresh))

    def _update(self, batches: int, meter: Meter) -> None:
        """Sample batches and update the policy with them (Algorithm 1, lines 10 to 15)."""
        for done in range(0, batches, BLOCK):
            count = min(BLOCK, batches - done)
            meter.add(self.ddpg.update_block(self.sample_block(count), count))
            self.updates += count

    def sample_block(self, count: int) -> Transitions:
        """Sample batches from both sources, relabelled, with cached intrinsic rewards.

        Args:
            count: Batches; sampling several at once costs little more than one.

        Returns:
            Batches of equal size, concatenated, each with the same share of imagined transitions.
        """
        size = self.config.schedule.workers * self.config.ddpg.batch_size
        imagined = round(self.imagined_share * size)
        sources = []
        if imagined < size:
            sources.append(self.real.sample(count * (size - imagined)))
        if imagined:
            sources.append(self.imagined.sample(count * imagined))
        return sources[0] if len(sources) == 1 else Transitions.interleave(sources, count)

    @property
    def imagined_share(self) -> float:
        """Imagined share of a batch.

        As configured, or p(imag): newly imagined transitions over all transitions collected so
        far (paper, section III.D).
        """
        if self.imagined.replay.num_episodes == 0:
            return 0.0
        if self.config.imagination.share is not None:
            return self.config.imagination.share
        return self.imagined.collected / (self.imagined.collected + self.real.collected)

    def state_dict(self) -> dict[str, Any]:
        """State for ``load_state_dict``, without the real episodes: tensors and scalars."""
        state = {
            "epoch": self.epoch,
            "cycle": self.cycle,
            "updates": self.updates,
            "generator": self.generator.get_state(),
            "policy": self.policy.snapshot(),
            "ddpg": self.ddpg.state_dict(),
            "ensemble": self.ensemble.state_dict(),
            "imagined": self.imagined.state_dict(),
        }
        if self.contact is not None:
            state["contact"] = self.contact.state_dict()
        return state

    def load_state_dict(
        self, state: dict[str, Any], episodes_by_epoch: Iterable[Iterable[Episode]]
    ) -> None:
        """Continue from the state of a learner of the same settings.

        Args:
            state: From ``state_dict``.
            episodes_by_epoch: The real episodes of each finished epoch, in order. They are
                iterated once, so that they can be read one epoch at a time.
        """
        self.real.clear()
        for epoch, episodes in enumerate(episodes_by_epoch, start=1):
            self.real.add(episodes, epoch=epoch)
        self.epoch = state["epoch"]
        self.cycle = state["cycle"]
        self.updates = state["updates"]
        self.generator.set_state(state["generator"].cpu())
        self.policy.load_snapshot(state["policy"])
        self.ddpg.load_state_dict(state["ddpg"])
        self.ensemble.load_state_dict(state["ensemble"])
        self.imagined.load_state_dict(state["imagined"])
        if self.contact is not None:
            self.contact.load_state_dict(state["contact"])
