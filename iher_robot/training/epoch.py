"""An epoch on its way from the robot to the learner and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from iher_robot.learning.episode import Episode

Row = dict[str, float]


@dataclass
class CollectedEpoch:
    """Real episodes that nothing was learned from yet.

    Attributes:
        number: Of the epoch, from 1.
        episodes: So far.
        ticks: Charged for them.
        earlier: Whether they are of earlier runs.
    """

    number: int
    episodes: list[Episode] = field(default_factory=list)
    ticks: int = 0
    earlier: bool = False


@dataclass(frozen=True)
class EpochData:
    """What the learner is given of an epoch.

    Attributes:
        epoch: Its number, from 1.
        episodes: Its real episodes.
        evaluate: Whether the policy is to be judged afterwards.
        known: Metrics that are known before.
        earlier: Whether the episodes are of earlier runs.
    """

    epoch: int
    episodes: Sequence[Episode]
    evaluate: bool
    known: Mapping[str, float]
    earlier: bool


@dataclass(frozen=True)
class Learned:
    """What the learner made of it.

    Attributes:
        lesson: What it was given.
        metrics: Of learning, and of an evaluation in simulation.
    """

    lesson: EpochData
    metrics: Mapping[str, float]
