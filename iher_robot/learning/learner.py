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
from iher_robot.learning.goal_model import REAL, GoalModel, Shapes, moved_goal
from iher_robot.learning.imagination.dynamics import DynamicsEnsemble
from iher_robot.learning.imagination.intrinsic import refresh_intrinsic
from iher_robot.learning.imagination.source import ImaginarySource, Progress
from iher_robot.learning.metrics import Meter
from iher_robot.learning.networks.data_parallel import ALONE, Peers, require_equal_shares
from iher_robot.learning.policy import Policy
from iher_robot.learning.replay import BLOCK, EpisodeReplay, Transitions
from iher_robot.learning.symmetry import Symmetry, augment

DYNAMICS_CHUNK = 25


def _require_equal_shares(config: LearnerConfig, peers: Peers) -> None:
    sections = ["ddpg", "dynamics"] if config.imagination.enabled else ["ddpg"]
    for section in sections:
        require_equal_shares(
            f"learner.schedule.workers x learner.{section}.batch_size",
            config.schedule.workers * getattr(config, section).batch_size,
            peers,
        )


def silent(phase: str, done: int, total: int) -> None:
    """Report no progress."""


class Learner:
    """Learns a goal-conditioned policy from real episodes and from imagination.

    One epoch is ``add_real`` with the episodes that ``acting_policy`` and ``explorer`` collected,
    then ``learn``.

    Args:
        shapes: Sizes of the arrays.
        goal_model: Achieved goals, rewards, goals to imagine.
        config: Settings.
        seed: Seeds every draw of the learner.
        device: Where replay, models and policy live.
        symmetry: Maps that leave the task unchanged, for ``config.symmetry``.
        contact_model: Where effector and object are, for ``config.contact``.
        peers: Learners of the same settings, seed and real episodes, in other processes; each
            computes on its share of every batch, and all of them stay the same.

    Raises:
        ValueError: A setting asks for what the task does not declare, or for batches of which the
            peers cannot have equal shares.
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
        self.shapes = shapes
        self.goal_model = goal_model
        self.learning_goals = goal_model.tightened(config.replay.tolerance)
        self.config = config
        self.device = device
        self.symmetry = symmetry if config.symmetry.enabled else None
        if config.symmetry.enabled and symmetry is None:
            raise ValueError(
                "learner.symmetry.enabled is true, but the task declares no symmetries; set it to "
                "false"
            )
        for section in ("ddpg", "dynamics"):
            if getattr(config, section).inputs == "relative" and not shapes.shifted_entries:
                raise ValueError(
                    f"learner.{section}.inputs is relative, but the task declares no entries that "
                    "a shift changes; set it to absolute"
                )
        if config.contact.enabled and contact_model is None:
            raise ValueError(
                "learner.contact.enabled is true, but the task declares no object; set it to false"
            )
        _require_equal_shares(config, peers)
        initial = torch.Generator().manual_seed(seed)
        self.policy = Policy.from_config(shapes, config, generator=initial, device=device)
        self.ddpg = DDPG(self.policy, shapes, config, generator=initial, device=device, peers=peers)
        self.ensemble = DynamicsEnsemble(
            shapes,
            config.dynamics,
            generator=initial,
            device=device,
            symmetry=self.symmetry,
            products=self.policy.products,
            peers=peers,
        )
        self.generator = torch.Generator(device).manual_seed(seed)
        self.real = self._real_replay(config.replay.capacity)
        self.imagined = ImaginarySource(
            shapes,
            self.learning_goals,
            config,
            self.real,
            generator=self.generator,
            device=device,
            symmetry=self.symmetry,
        )
        self.contact: ContactLearner | None = None
        if config.contact.enabled and contact_model is not None:
            self.contact = ContactLearner(
                shapes, contact_model, config, seed=seed, device=device, peers=peers
            )
        self.epoch = 0
        self.cycle = 0
        self.updates = 0
        self.real_collected = 0
        self.fresh = 0

    def acting_policy(self, device: torch.device) -> Policy:
        """Copy of the policy that acts; it does not follow later updates.

        Args:
            device: Where the actor computes.
        """
        return Policy.from_snapshot(self.ddpg.acting_snapshot(), device=device)

    def explorer(self) -> Explorer:
        """What disturbs the actions of an actor on the CPU; it does not follow later updates."""
        contact = None if self.contact is None else self.contact.snapshot(torch.device("cpu"))
        return Explorer(self.config.exploration, contact)

    def add_real(self, episodes: Sequence[Episode]) -> None:
        """Begin an epoch with the real episodes that were collected for it.

        Args:
            episodes: Episodes of this epoch. Ticks that are not valid are left out, and no
                transition or hindsight goal spans one.
        """
        self.epoch += 1
        segments = self._store_real(episodes, self.epoch)
        if segments:
            fresh = self._real_replay(len(segments) * self.shapes.episode_ticks)
            self._add(segments, fresh, self.epoch)
            sample = self._sample(fresh, fresh.num_transitions)
            self.policy.update_normalizers(sample.observation, sample.goal)
            if self.contact is not None:
                self.contact.add_real(fresh, episodes)

    def _real_replay(self, capacity: int) -> EpisodeReplay:
        return EpisodeReplay(
            self.shapes,
            capacity=capacity,
            source=REAL,
            device=self.device,
            between=self.config.replay.actions == "between",
        )

    def _store_real(self, episodes: Iterable[Episode], epoch: int) -> list[Episode]:
        segments = [segment for episode in episodes for segment in episode.segments()]
        self._add(segments, self.real, epoch)
        self.fresh = sum(len(segment) for segment in segments)
        self.real_collected += self.fresh
        return segments

    def _add(self, segments: Sequence[Episode], replay: EpisodeReplay, epoch: int) -> None:
        moved_m, still_weight = self.config.replay.moved_m, self.config.replay.still_weight
        for segment in segments:
            replay.add(
                torch.as_tensor(segment.observations, device=self.device).unsqueeze(0),
                torch.as_tensor(segment.actions, device=self.device).unsqueeze(0),
                torch.as_tensor(segment.desired_goal, device=self.device).unsqueeze(0),
                epoch=epoch,
                requested=torch.as_tensor(segment.requested_actions, device=self.device).unsqueeze(
                    0
                ),
                weight=1.0 if moved_goal(self.goal_model, segment, moved_m) else still_weight,
            )

    def learn(self, progress: Progress = silent) -> dict[str, float]:
        """Run the rest of the epoch: models, imagination and policy updates.

        Args:
            progress: Told how far each phase is.

        Returns:
            Metrics of the epoch.

        Raises:
            ValueError: No real transition has been added.
            FloatingPointError: The dynamics models diverged.
        """
        if self.real.num_episodes == 0:
            raise ValueError("cannot learn: no real transition has been added; call add_real first")
        schedule = self.config.schedule
        imagination = self.config.imagination.enabled
        meter = Meter()
        if imagination:
            self._train_dynamics(meter, progress)
            if self.config.imagination.regenerate or self.imagined.replay.num_episodes == 0:
                meter.add(self._refill(progress))
        if self.contact is not None:
            updates = max(1, round(self.config.contact.updates_per_step * self.fresh))
            meter.add(self.contact.learn(self.real, updates, self.symmetry).means())
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
        seconds = time.perf_counter() - started
        return meter.means() | {
            "epoch": self.epoch,
            "updates": self.updates,
            "updates_per_second": updates / seconds,
            "real_transitions": self.real_collected,
            "imagined_transitions": self.imagined.collected,
            "imagined_stored": self.imagined.level,
            "imagined_share": self.imagined_share,
        }

    def _update(self, batches: int, meter: Meter) -> None:
        for drawn in range(0, batches, BLOCK):
            count = min(BLOCK, batches - drawn)
            meter.add(self.ddpg.update_block(self.sample_block(count), count))
            self.updates += count

    def _updates_of_epoch(self) -> int:
        schedule = self.config.schedule
        if schedule.updates_per_step is None:
            return schedule.cycles * schedule.batches
        return max(1, round(schedule.updates_per_step * self.fresh))

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
        return self.imagined.collected / (self.imagined.collected + self.real_collected)

    def sample_block(self, count: int) -> Transitions:
        """Draw batches from both sources, relabelled, with cached intrinsic rewards.

        They are drawn together, which costs little more than drawing one.

        Args:
            count: How many.

        Returns:
            Batches of the same size, one behind the other, each with the same share of imagined
            transitions.
        """
        size = self.config.schedule.workers * self.config.ddpg.batch_size
        imagined = round(self.imagined_share * size)
        sources = []
        if imagined < size:
            sources.append(self._sample(self.real, count * (size - imagined)))
        if imagined:
            sources.append(self._augmented(self.imagined.sample(count * imagined)))
        return sources[0] if len(sources) == 1 else Transitions.interleave(sources, count)

    def _sample(self, replay: EpisodeReplay, count: int) -> Transitions:
        fraction = self.config.replay.future_fraction
        return self._augmented(
            replay.sample(count, self.generator, self.learning_goals, future_fraction=fraction)
        )

    def _augmented(self, batch: Transitions) -> Transitions:
        return augment(batch, self.symmetry, self.generator)

    def _train_dynamics(self, meter: Meter, progress: Progress) -> None:
        schedule = self.config.schedule
        steps = schedule.dynamics_steps
        if self.epoch == 1:
            steps *= schedule.first_epoch_dynamics_factor
        self.ensemble.fit_normalizers(self.real, self.generator)
        batch_size = schedule.workers * self.config.dynamics.batch_size
        for done in range(0, steps, DYNAMICS_CHUNK):
            chunk = min(DYNAMICS_CHUNK, steps - done)
            loss = self.ensemble.train(
                self.real, chunk, batch_size=batch_size, generator=self.generator
            )
            progress("dynamics", done + chunk, steps)
        meter.add({"dynamics_loss": loss})
        if self.config.intrinsic.enabled:
            reward = refresh_intrinsic(self.real, self.ensemble, self.config.intrinsic)
            meter.add({"intrinsic_real": reward.mean()})
            if not self.config.imagination.regenerate and self.imagined.replay.num_episodes:
                refresh_intrinsic(self.imagined.replay, self.ensemble, self.config.intrinsic)

    def _refill(self, progress: Progress) -> dict[str, float]:
        return self.imagined.refill(
            self.ensemble, self.policy, epoch=self.epoch, cycle=self.cycle, progress=progress
        )

    def state_dict(self) -> dict[str, Any]:
        """All that ``load_state_dict`` needs beside the real episodes: tensors and scalars."""
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
        """Continue where another learner of the same settings was.

        Args:
            state: What its ``state_dict`` returned.
            episodes_by_epoch: The real episodes of each finished epoch, in order. They are gone
                through once, so that they may be read one epoch at a time.
        """
        self.real.clear()
        self.real_collected = 0
        for epoch, episodes in enumerate(episodes_by_epoch, start=1):
            self._store_real(episodes, epoch)
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
