"""Deployed episode: a policy acts on the robot, and every tick is logged."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers import DriverError
from iher_robot.deployment.log import DeploymentLog, EpisodeRecord
from iher_robot.deployment.robot_checks import require_home
from iher_robot.env.goal_env import EpisodeAborted, GoalRobotEnv, Observation
from iher_robot.errors import describe
from iher_robot.evaluation.compatibility import TrainedPolicy
from iher_robot.rollout.actor import PolicyActor
from iher_robot.rollout.durable_recorder import DurableRecorder
from iher_robot.rollout.episode import run_episode
from iher_robot.rollout.observer import (
    Action,
    EpisodeObserver,
    EpisodeStart,
    Transition,
)
from iher_robot.storage.episode import DONE

_NO_OUTCOME = dict.fromkeys(
    (
        "seq",
        "applied",
        "clipped",
        "refusal",
        "tick_valid",
        "ticks",
        "next_observation",
        "success",
        "step_ms",
        "q",
        "dq",
        "ee_pos",
        "ee_linvel",
        "mode",
        "error",
    )
)


class DeploymentRecorder(DurableRecorder):
    """Durable recorder of a deployed episode, which must begin at home."""

    def start(self, start: EpisodeStart) -> None:
        """Check that the reset brought the robot home, and begin the record.

        Raises:
            ResetFailed: The robot is not at home.
        """
        assert isinstance(start.env, GoalRobotEnv)
        assert start.env.state is not None, "a reset that returns leaves a state"
        require_home(start.env.robot_spec, start.env.state)
        super().start(start)


class TimedActor(PolicyActor):
    """Acts with a policy, and measures how long it takes.

    Attributes:
        begun: Time at which the last action was asked for. s
        done: Time at which it was chosen. s
    """

    begun = done = 0.0

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Choose the action of the next tick, in [-1, 1]. ``(action_dim,)``"""
        self.begun = time.perf_counter()
        action = super().act(observation)
        self.done = time.perf_counter()
        return action


class TickLogger(EpisodeObserver):
    """Writes a log line for each tick, including one that an error ended.

    Args:
        env: The robot.
        actor: Chooses the actions.
        recorder: Charges the ticks, before this logs them.
        log: The log.
        record: Record of the episode.

    Attributes:
        lost: The driver error that ended the episode; None without one.
    """

    def __init__(
        self,
        env: GoalRobotEnv,
        actor: TimedActor,
        recorder: DeploymentRecorder,
        log: DeploymentLog,
        record: EpisodeRecord,
    ) -> None:
        self._env = env
        self._actor = actor
        self._recorder = recorder
        self._log = log
        self._record = record
        self._line: dict[str, Any] | None = None
        self.lost: DriverError | None = None

    def before_tick(self, observation: Observation, action: Action) -> None:
        """Begin the line of a tick."""
        self._line = {
            "episode": self._record.episode,
            "tick": self._recorder.ticks,
            "time": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "requested": action,
            "observation": observation["observation"],
            "desired_goal": observation["desired_goal"],
            "policy_ms": 1e3 * (self._actor.done - self._actor.begun),
            **_NO_OUTCOME,
        }

    def after_tick(self, transition: Transition) -> None:
        """Write the line of a tick with its outcome."""
        step_ms = 1e3 * (time.perf_counter() - self._actor.done)
        self._write({"step_ms": step_ms} | self._outcome(transition))

    def abort(self, error: EpisodeAborted) -> None:
        """Write the line of the tick that failed."""
        self._write({"error": describe(error)})
        if isinstance(error.__cause__, DriverError):  # link or lease lost: no further episode
            self.lost = error.__cause__

    def end(self, error: BaseException | None) -> None:
        """Write the line of a tick that an error ended."""
        if error is not None:
            self._write({"error": describe(error)})

    def _write(self, outcome: dict[str, Any]) -> None:
        line, self._line = self._line, None
        if line is not None:
            self._log.tick(line | outcome)

    def _outcome(self, transition: Transition) -> dict[str, Any]:
        tick, state = transition.tick, self._env.state
        assert state is not None, "a step that returns leaves a state"
        return {
            "seq": tick.seq,
            "applied": tick.action_applied,
            "clipped": tick.clipped,
            "refusal": tick.refusal,
            "tick_valid": tick.valid,
            "ticks": tick.elapsed,
            "next_observation": transition.next_observation["observation"],
            "success": transition.success,
            "q": state.q,
            "dq": state.dq,
            "ee_pos": state.ee_pos,
            "ee_linvel": state.ee_linvel,
            "mode": state.mode,
        }


def run_deployed_episode(
    env: GoalRobotEnv,
    trained: TrainedPolicy,
    log: DeploymentLog,
    recorder: DeploymentRecorder,
    *,
    seed: int,
    ticks: int,
) -> EpisodeRecord:
    """Run one episode without noise; the robot is left held and disarmed however it ends.

    Args:
        env: The robot, open.
        trained: The policy.
        log: Receives every tick, including one that an error ends.
        recorder: Stores and charges every tick.
        seed: Seed of start and goal.
        ticks: Maximal number of ticks to charge.

    Returns:
        The record of the episode; it is in the log after an error too.

    Raises:
        UserError: The robot did not reach home.
        DriverError: The robot was lost.
    """
    record = log.begin_episode(seed)
    actor = TimedActor(trained.policy)
    logger = TickLogger(env, actor, recorder, log, record)
    with recorder:
        try:
            run_episode(env, actor, recorder, seed=seed, ticks=ticks, observers=[logger])
            record.ended = recorder.aborted or DONE
            record.success = record.task_success = recorder.success
        except BaseException as error:
            record.ended = describe(error)
            raise
        finally:
            record.ticks = recorder.ticks
            log.sync()
    if logger.lost is not None:
        raise logger.lost
    return record
