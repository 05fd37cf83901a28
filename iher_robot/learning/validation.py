"""Checks that a task and a group of learners allow what the settings enable."""

from __future__ import annotations

from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.contact.model import ContactModel
from iher_robot.learning.goal_model import Shapes
from iher_robot.learning.networks.data_parallel import Peers, require_equal_shards
from iher_robot.learning.symmetry import Symmetry


def validate(
    config: LearnerConfig,
    shapes: Shapes,
    symmetry: Symmetry | None,
    contact_model: ContactModel | None,
    peers: Peers,
) -> None:
    """Check settings against what the task declares and the number of learners.

    Args:
        config: Settings.
        shapes: Which entries of an observation a shift changes.
        symmetry: The task's; None if it declares none.
        contact_model: The task's; None if it declares no object.
        peers: The learners, which take equal shards of every batch.

    Raises:
        ValueError: A setting needs what the task does not declare, or a batch does not divide into
            equal shards.
    """
    if config.symmetry.enabled and symmetry is None:
        raise ValueError(
            "learner.symmetry.enabled is true, but the task declares no symmetries; set it to false"
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
    for section in ("ddpg", "dynamics") if config.imagination.enabled else ("ddpg",):
        require_equal_shards(
            f"learner.schedule.workers x learner.{section}.batch_size",
            config.schedule.workers * getattr(config, section).batch_size,
            peers,
        )
