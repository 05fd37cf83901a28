"""Snapshot of a learner's policy and explorer, for simulator processes."""

from __future__ import annotations

import torch

from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.contact.approach import ContactPolicy
from iher_robot.learning.contact.model import ContactModel
from iher_robot.learning.exploration import Explorer
from iher_robot.learning.learner import Learner
from iher_robot.learning.policy import Policy
from iher_robot.rollout.simulators.messages import Message

_CPU = torch.device("cpu")


def take_snapshot(learner: Learner) -> Message:
    """Serialize what ``Learner.acting_policy`` and ``Learner.explorer`` return now."""
    contact = learner.contact
    return {
        "policy": learner.acting_policy(_CPU).snapshot(),
        "contact": None if contact is None else contact.policy.snapshot(),
        "rests": contact is not None and contact.rests,
    }


def read_snapshot(
    snapshot: Message, config: LearnerConfig, contact_model: ContactModel | None
) -> tuple[Policy, Explorer]:
    """Deserialize the result of ``take_snapshot``.

    Args:
        snapshot: Snapshot of a learner of the same settings.
        config: The settings.
        contact_model: The task's contact model.

    Returns:
        The policy and the explorer, both on the CPU.
    """
    contact = None
    if snapshot["contact"] is not None:
        assert contact_model is not None, "a learner with a second policy has a task with an object"
        second = Policy.from_snapshot(snapshot["contact"], device=_CPU)
        contact = ContactPolicy(second, contact_model, config.contact, rests=snapshot["rests"])
    policy = Policy.from_snapshot(snapshot["policy"], device=_CPU)
    return policy, Explorer(config.exploration, contact)
