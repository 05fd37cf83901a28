"""Data of an epoch, from the robot to the learner, and the metrics that come back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from iher_robot.learning.episode import Episode

Row = dict[str, float]


@dataclass
class EpochData:
    """Real episodes of an epoch, for the learner.

    Attributes:
        number: Number of the epoch, from 1.
        episodes: Its real episodes so far.
        ticks: Control ticks charged for them.
        earlier: Whether they are of earlier runs.
        evaluate: Whether the policy is evaluated after learning from them.
        metrics: Metrics that are known before learning.
    """

    number: int
    episodes: list[Episode] = field(default_factory=list)
    ticks: int = 0
    earlier: bool = False
    evaluate: bool = False
    metrics: Row = field(default_factory=dict)


@dataclass(frozen=True)
class LearnedEpoch:
    """An epoch that was learned.

    Attributes:
        data: What was learned from.
        metrics: Metrics of learning, and of an evaluation in simulation.
    """

    data: EpochData
    metrics: Mapping[str, float]
