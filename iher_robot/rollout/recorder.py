"""Outcome and record of an episode, kept while it runs."""

from __future__ import annotations

from iher_robot.env.goal_env import EpisodeAborted, Observation
from iher_robot.learning.episode import Episode
from iher_robot.learning.goal_model import REAL
from iher_robot.rollout.observer import Action, EpisodeObserver, EpisodeStart, Transition
from iher_robot.storage.episode import RecordedTick, make_episode


class EpisodeOutcome(EpisodeObserver):
    """Ticks charged for an episode, and whether it succeeded; up to date at any moment.

    Attributes:
        ticks: Control ticks charged so far; the one in flight counts, since the robot may have
            moved in it.
        success: Whether the last step met the goal; never so in an aborted episode.
        aborted: Why the episode could not go on, empty if it could.
        policy_source: Index of the replay source that the policy was conditioned on.
    """

    def __init__(self) -> None:
        self.ticks = 0
        self.success = False
        self.aborted = ""
        self.policy_source = REAL
        self._in_tick = False

    def start(self, start: EpisodeStart) -> None:
        """Note what the policy is conditioned on."""
        self.policy_source = start.policy_source

    def before_tick(self, observation: Observation, action: Action) -> None:  # noqa: ARG002
        """Charge the tick before it begins."""
        self._charge(1)
        self._in_tick = True

    def after_tick(self, transition: Transition) -> None:
        """Charge ticks that passed unseen as well."""
        self._end_tick(transition.info.get("ticks", 1))
        self.success = transition.success

    def abort(self, error: EpisodeAborted) -> None:
        """Charge the tick that failed, if one had begun; the episode counts as a failure."""
        if self._in_tick:
            self._end_tick(error.ticks)
        self.success = False
        self.aborted = str(error)

    def _end_tick(self, elapsed: int) -> None:
        self._in_tick = False
        self._charge(elapsed - 1)

    def _charge(self, ticks: int) -> None:
        self.ticks += ticks


class Recorder(EpisodeOutcome):
    """Keeps every whole tick of an episode in memory."""

    def __init__(self) -> None:
        super().__init__()
        self._start: Observation | None = None
        self._ticks: list[RecordedTick] = []

    def start(self, start: EpisodeStart) -> None:
        """Keep the observation of the reset."""
        super().start(start)
        self._start = start.observation

    def after_tick(self, transition: Transition) -> None:
        """Charge and record a tick."""
        tick = transition.tick
        self._end_tick(tick.elapsed)
        # One call: an interrupt finds the whole tick in the record, or nothing of it.
        self._record(
            RecordedTick(
                observation=transition.next_observation["observation"],
                action=tick.action_applied,
                requested_action=transition.action,
                valid=tick.valid,
                seq=tick.seq,
                elapsed=tick.elapsed,
            )
        )
        self.success = transition.success

    def episode(self) -> Episode | None:
        """The ticks recorded whole, as an episode; None before the first."""
        if self._start is None or not self._ticks:
            return None
        start = self._start
        return make_episode(start["observation"], start["desired_goal"], self._ticks)

    def _record(self, tick: RecordedTick) -> None:
        self._ticks.append(tick)
