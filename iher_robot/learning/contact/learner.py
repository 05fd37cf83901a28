"""Training of the second policy, which brings the effector to the object."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.contact.approach import ContactPolicy
from iher_robot.learning.contact.model import ContactModel, EffectorGoals, touched
from iher_robot.learning.ddpg import DDPG
from iher_robot.learning.episode import Episode
from iher_robot.learning.goal_model import Shapes
from iher_robot.learning.metrics import Meter
from iher_robot.learning.networks.data_parallel import ALONE, Peers
from iher_robot.learning.policy import Policy
from iher_robot.learning.replay import EpisodeReplay
from iher_robot.learning.symmetry import Symmetry, augment
from iher_robot.learning.transitions import BLOCK

TOUCH_WINDOW = 20
"""Newest episodes over which the share of touches is taken."""


def _config_of_second_policy(config: LearnerConfig) -> LearnerConfig:
    changes = {
        "hidden": config.contact.hidden,
        "critics": 1,
        "target_subset": 1,
        "policy_average": None,
        "source_input": False,
        "component_critics": False,
        "target_update": "update",
    }
    return config.model_copy(update={"ddpg": config.ddpg.model_copy(update=changes)})


class ContactLearner:
    """Trains the second policy on the real data, with effector positions as hindsight goals.

    Args:
        shapes: Sizes of the task's arrays.
        model: Positions of effector and object.
        config: Settings of the learner. The second policy has smaller networks and one critic, and
            is otherwise optimised like the main one.
        seed: Seeds every draw.
        device: Where it computes.
        peers: Learners with which it shares every batch.

    Attributes:
        rests: Whether training has ended, because the object was touched often enough.
    """

    def __init__(
        self,
        shapes: Shapes,
        model: ContactModel,
        config: LearnerConfig,
        *,
        seed: int,
        device: torch.device,
        peers: Peers = ALONE,
    ) -> None:
        self.config = config
        self.model = model
        self.goals = EffectorGoals(model, config.contact.radius_m)
        own = _config_of_second_policy(config)
        entries = model.effector_entries
        shapes = dataclasses.replace(shapes, goal_dim=len(entries), goal_entries=entries)
        initial = torch.Generator().manual_seed(seed)
        self.policy = Policy.from_config(shapes, own, generator=initial, device=device)
        self.ddpg = DDPG(self.policy, shapes, own, generator=initial, device=device, peers=peers)
        self.generator = torch.Generator(device).manual_seed(seed)
        self._touched: deque[bool] = deque(maxlen=TOUCH_WINDOW)
        self.rests = False

    def add_real(self, fresh: EpisodeReplay, episodes: Sequence[Episode]) -> None:
        """Add an epoch's episodes, unless the policy rests.

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
        """Whether the object was touched in an episode."""
        observations = torch.as_tensor(episode.observations)
        start = self.model.object_position(observations[:1])
        contact = self.config.contact
        return touched(self.model, start, observations, contact.radius_m, contact.touched_m)

    def learn(self, real: EpisodeReplay, updates: int, symmetry: Symmetry | None) -> Meter:
        """Take gradient steps, unless the policy rests.

        Args:
            real: All real data.
            updates: Gradient steps.
            symmetry: The task's, if it is used.

        Returns:
            Metrics of the steps.
        """
        meter = Meter()
        if self.rests:
            return meter
        size = self.config.schedule.workers * self.config.ddpg.batch_size
        for done in range(0, updates, BLOCK):
            batches = min(BLOCK, updates - done)
            drawn = real.sample(batches * size, self.generator, self.goals, future_fraction=1.0)
            # The stored intrinsic reward is for the main policy only.
            drawn = dataclasses.replace(drawn, intrinsic=torch.zeros_like(drawn.intrinsic))
            drawn = augment(drawn, symmetry, self.generator)
            report = self.ddpg.update_block(drawn, batches)
            meter.add({"contact_critic_loss": report["critic_loss"]})
        return meter

    def state_dict(self) -> dict[str, Any]:
        """State for ``load_state_dict``: tensors and scalars."""
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
        """Copy of the policy for an actor, independent of later updates."""
        policy = Policy.from_snapshot(self.policy.snapshot(), device=device)
        return ContactPolicy(policy, self.model, self.config.contact, rests=self.rests)
