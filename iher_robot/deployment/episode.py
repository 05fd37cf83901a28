"""One episode of a policy on a robot, each tick of it logged."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from typing import Any

from drivers import DriverError, RobotState
from iher_robot.deployment.log import DeploymentLog, EpisodeRecord
from iher_robot.deployment.robot_checks import require_home
from iher_robot.env.goal_env import EpisodeAborted, GoalRobotEnv, Observation
from iher_robot.errors import describe
from iher_robot.evaluation.compatibility import Actor
from iher_robot.learning.goal_model import REAL
from iher_robot.rollout.episode import choose_action
from iher_robot.rollout.recorder import DurableRecorder
from iher_robot.storage.episode import DONE

_UNKNOWN_OUTCOME = dict.fromkeys(
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


def run_deployed_episode(
    env: GoalRobotEnv,
    actor: Actor,
    log: DeploymentLog,
    recorder: DurableRecorder,
    *,
    seed: int,
    ticks: int,
) -> EpisodeRecord:
    """Run one episode without noise; the robot is left held and disarmed however it ends.

    Args:
        env: The robot, open.
        actor: The policy.
        log: Takes every tick, the one in flight included.
        recorder: Keeps and counts every tick.
        seed: Decides start and goal.
        ticks: Most ticks to run.

    Returns:
        What became of it; also in the log, whatever this raises.

    Raises:
        UserError: The robot did not get home.
        DriverError: The robot was lost.
    """
    record = log.begin_episode(seed)
    success = False
    lost: DriverError | None = None
    with recorder:
        try:
            observation, _ = env.reset(seed=seed)
            assert env.state is not None
            require_home(env.robot_spec, env.state)
            recorder.start(observation)
            while recorder.ticks < ticks:
                observation, success = _run_tick(env, actor, log, record, recorder, observation)
            record.ended = DONE
            record.success = record.task_success = success
        except EpisodeAborted as error:
            record.ended = recorder.aborted = str(error)
            if isinstance(error.__cause__, DriverError):  # the link or the lease, not the episode
                lost = error.__cause__
        except BaseException as error:
            record.ended = describe(error)
            raise
        finally:
            env.hold()
            record.ticks = recorder.ticks
            log.sync()
    if lost is not None:
        raise lost
    return record


def _run_tick(
    env: GoalRobotEnv,
    actor: Actor,
    log: DeploymentLog,
    record: EpisodeRecord,
    recorder: DurableRecorder,
    observation: Observation,
) -> tuple[Observation, bool]:
    begun = time.perf_counter()
    action = choose_action(actor.policy, observation, REAL)[0].numpy()
    chosen = time.perf_counter()
    line: dict[str, Any] = {
        "episode": record.episode,
        "tick": recorder.ticks + 1,
        "time": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "requested": action,
        "observation": observation["observation"],
        "desired_goal": observation["desired_goal"],
        "policy_ms": 1e3 * (chosen - begun),
        **_UNKNOWN_OUTCOME,
    }
    try:
        after, info = recorder.step(env, action)
        line["step_ms"] = 1e3 * (time.perf_counter() - chosen)
        line |= _outcome(after, info, env.state)
    except BaseException as error:
        line["error"] = describe(error)
        raise
    finally:
        log.tick(line)
    return after, bool(info["is_success"])


def _outcome(after: Observation, info: dict[str, Any], state: RobotState | None) -> dict[str, Any]:
    assert state is not None, "a step that returns leaves a state"
    return {
        "seq": state.seq,
        "applied": info["action_applied"],
        "clipped": info["clipped"],
        "refusal": info["refusal"],
        "tick_valid": info["tick_valid"],
        "ticks": info["ticks"],
        "next_observation": after["observation"],
        "success": bool(info["is_success"]),
        "q": state.q,
        "dq": state.dq,
        "ee_pos": state.ee_pos,
        "ee_linvel": state.ee_linvel,
        "mode": state.mode,
    }
