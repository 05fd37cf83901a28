from __future__ import annotations

import json
import warnings
from collections.abc import Iterator

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from drivers import (
    FaultLatched,
    InvalidCommand,
    LeaseRefused,
    LifecycleError,
    LinkLost,
    ResetOutcome,
)
from iher_robot.env.goal_env import EpisodeAborted, GoalRobotEnv, LinkTooSlow, ResetFailed, make_env
from iher_robot.env.registration import ENV_IDS, register_envs
from iher_robot.errors import NoSolution, UserError
from iher_robot.rollout.episode import run_episode
from iher_robot.rollout.observer import EpisodeStart
from iher_robot.rollout.recorder import Recorder
from tasks import MissingObject, make_task
from tests.drivers.fake_robot import PERIOD_NS, FakeRobot
from tests.random_actor import RandomActor

FORWARD = np.array([0.5, 0.0, 0.0, 0.0], dtype=np.float32)


@pytest.fixture
def robot() -> FakeRobot:
    return FakeRobot()


@pytest.fixture
def env(robot: FakeRobot) -> Iterator[GoalRobotEnv]:
    with GoalRobotEnv(robot, make_task("push"), max_invalid_ticks=2) as made:
        yield made


@pytest.mark.parametrize("env_id", list(ENV_IDS))
def test_registered_environments_pass_gymnasiums_checks(env_id: str) -> None:
    made = gym.make(env_id)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Unbounded observations are what goal environments of this family have.
        warnings.filterwarnings("ignore", message=".*(infinity|unbounded|inf).*")
        check_env(made.unwrapped, skip_render_check=True)
    made.close()


def test_registered_environments_end_after_fifty_ticks() -> None:
    register_envs()  # a second time
    made = gym.make("iher_robot/Reach-v0")
    made.reset(seed=0)
    ends = [made.step(made.action_space.sample())[2:4] for _ in range(50)]
    assert ends == [(False, False)] * 49 + [(False, True)]
    made.close()


def test_making_an_environment_does_not_connect(robot: FakeRobot) -> None:
    made = GoalRobotEnv(robot, make_task("push"))
    shapes = {key: box.shape for key, box in made.observation_space.spaces.items()}
    assert shapes == {"observation": (25,), "achieved_goal": (3,), "desired_goal": (3,)}
    assert robot.calls == []
    with pytest.raises(gym.error.ResetNeeded):
        made.step(FORWARD)


def test_a_step_is_one_control_tick(env: GoalRobotEnv, robot: FakeRobot) -> None:
    obs, _ = env.reset(seed=0)
    before = robot.seq
    obs, _, _, _, info = env.step(FORWARD)
    assert robot.seq == before + 1
    assert robot.calls.count("advance") == 1
    assert info["ticks"] == 1
    assert info["tick_valid"]
    assert info["refusal"] is None
    np.testing.assert_allclose(obs["observation"][:3], (0.525, 0.5, 0.5))
    np.testing.assert_array_equal(info["action_applied"], FORWARD)


def test_actions_are_clipped_and_otherwise_equal_to_the_bit(env: GoalRobotEnv) -> None:
    env.reset(seed=0)
    action = np.array([0.1, 1.5, -7.0, 0.3], dtype=np.float32)
    info = env.step(action)[4]
    np.testing.assert_array_equal(info["action_applied"], np.clip(action, -1, 1))
    action[:] = 9.0
    assert info["action_applied"].max() == 1.0, "the caller's array must not be shared"


def test_a_clipped_command_reports_what_was_applied(env: GoalRobotEnv, robot: FakeRobot) -> None:
    env.reset(seed=0)
    robot.clip_to_m = 0.01
    info = env.step(np.array([1.0, 0.1, -1.0, 0.0], dtype=np.float32))[4]
    assert info["clipped"] == ("ee_speed",)
    assert info["tick_valid"]
    np.testing.assert_allclose(info["action_applied"], [0.2, 0.1, -0.2, 0.0], rtol=1e-6)


def test_a_tick_missing_in_between_is_charged_and_masked(
    env: GoalRobotEnv, robot: FakeRobot
) -> None:
    env.reset(seed=0)
    robot.lost_ticks = 3
    info = env.step(FORWARD)[4]
    assert not info["tick_valid"]
    assert info["ticks"] == 4
    robot.lost_ticks = 0
    assert env.step(FORWARD)[4]["tick_valid"]


def test_a_dropped_measurement_is_charged_and_masked(env: GoalRobotEnv, robot: FakeRobot) -> None:
    first, _ = env.reset(seed=0)
    robot.frozen = True
    robot.clock.advance_ns(2 * PERIOD_NS)
    obs, _, _, _, info = env.step(FORWARD)
    assert (info["tick_valid"], info["ticks"]) == (False, 1)
    np.testing.assert_array_equal(info["action_applied"], 0.0)
    np.testing.assert_array_equal(obs["observation"], first["observation"])


def test_an_expired_command_is_a_held_tick(env: GoalRobotEnv, robot: FakeRobot) -> None:
    env.reset(seed=0)
    robot.clock.advance_ns(3 * PERIOD_NS)  # the policy thought for too long
    info = env.step(FORWARD)[4]
    assert info["refusal"] == "expired"
    assert not info["tick_valid"]
    np.testing.assert_array_equal(info["action_applied"], 0.0)
    assert env.step(FORWARD)[4]["tick_valid"]


def test_too_many_invalid_ticks_abort_the_episode(env: GoalRobotEnv, robot: FakeRobot) -> None:
    env.reset(seed=0)
    robot.lost_ticks = 1
    env.step(FORWARD)
    env.step(FORWARD)
    with pytest.raises(EpisodeAborted, match="3 invalid ticks, allowed: 2"):
        env.step(FORWARD)
    assert not robot.is_armed
    assert robot.calls[-1] == "hold"
    with pytest.raises(gym.error.ResetNeeded):
        env.step(FORWARD)
    robot.lost_ticks = 0
    env.reset()
    for _ in range(5):
        assert env.step(FORWARD)[4]["tick_valid"]


def test_a_stop_aborts_the_episode_and_keeps_the_next_from_starting(
    env: GoalRobotEnv, robot: FakeRobot
) -> None:
    env.reset(seed=0)
    robot.stop("pressed")
    with pytest.raises(EpisodeAborted, match="pressed"):
        env.step(FORWARD)
    with pytest.raises(FaultLatched, match="pressed"):
        env.reset()
    robot.clear_fault("emergency_stop")
    env.reset()
    assert env.step(FORWARD)[4]["tick_valid"]


@pytest.mark.parametrize("hook", ["advance", "read", "apply"])
def test_a_failing_robot_is_left_held_and_disarmed(
    env: GoalRobotEnv, robot: FakeRobot, hook: str
) -> None:
    env.reset(seed=0)
    robot.failing = {hook}
    with pytest.raises(OSError, match=f"{hook} failed"):
        env.step(FORWARD)
    assert not robot.is_armed
    assert robot.calls[-1] == "hold"


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_non_finite_action_moves_nothing(env: GoalRobotEnv, robot: FakeRobot, bad: float) -> None:
    env.reset(seed=0)
    with pytest.raises(InvalidCommand, match="finite"):
        env.step(np.array([0.0, bad, 0.0, 0.0]))
    assert not robot.is_armed
    assert "advance" not in robot.calls


def test_an_action_of_the_wrong_shape_is_an_error(env: GoalRobotEnv) -> None:
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"shape \(3,\), allowed: \(4,\)"):
        env.step(np.zeros(3))


def test_closing_and_leaving_end_disarmed_and_disconnected(robot: FakeRobot) -> None:
    def episode() -> None:
        with GoalRobotEnv(robot, make_task("push")) as made:
            made.reset(seed=0)
            made.step(FORWARD)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        episode()
    assert not robot.is_armed
    assert not robot.is_open
    assert robot.calls[-2:] == ["hold", "close"]


def test_holding_between_episodes_disarms(env: GoalRobotEnv, robot: FakeRobot) -> None:
    env.hold()  # before it was ever opened
    env.reset(seed=0)
    env.hold()
    assert robot.is_open
    assert not robot.is_armed
    with pytest.raises(LifecycleError, match="nothing to confirm"):
        robot.confirm_hands_clear()


def test_a_person_is_asked_and_the_same_start_is_retried(robot: FakeRobot) -> None:
    asked: list[str] = []
    made = GoalRobotEnv(robot, make_task("push"), ask_human=asked.append)
    plain, _ = made.reset(seed=3)
    robot.outcomes = [ResetOutcome.NEEDS_HUMAN, ResetOutcome.NEEDS_HUMAN]
    helped, _ = made.reset(seed=3)
    assert asked == ["the object fell off the table"] * 2
    assert robot.is_armed
    for key, value in plain.items():
        np.testing.assert_array_equal(value, helped[key])
    made.close()


@pytest.mark.parametrize("outcome", [ResetOutcome.NEEDS_HUMAN, ResetOutcome.FAILED])
def test_a_reset_that_is_not_done_arms_nothing(
    env: GoalRobotEnv, robot: FakeRobot, outcome: ResetOutcome
) -> None:
    robot.outcomes = [outcome]
    with pytest.raises(ResetFailed, match=f"{outcome.value}: the object fell off the table"):
        env.reset(seed=0)
    assert not robot.is_armed


def test_a_policy_file_gets_plain_json_with_both_digests(env: GoalRobotEnv) -> None:
    interface = json.loads(json.dumps(env.policy_interface(), allow_nan=False))
    assert interface["task"] == "push"
    assert interface["interface_digest"] == env.robot_spec.interface_digest
    assert interface["body_digest"] == env.robot_spec.body_digest
    assert interface["layout_digest"] == env.task.layout.digest()
    assert interface["controller"] == {"kind": "ee_delta", "blocks_gripper": True}


def test_incompatible_parts_are_refused_at_once(robot: FakeRobot) -> None:
    with pytest.raises(MissingObject, match="reports: none"):
        make_env("push", scene="reach")
    with pytest.raises(UserError, match="renders no images"):
        GoalRobotEnv(robot, make_task("push"), render_mode="rgb_array")


def test_blocked_grippers_do_not_move(env: GoalRobotEnv, robot: FakeRobot) -> None:
    env.reset(seed=0)
    env.step(np.array([0.0, 0.0, 0.0, 1.0]))
    assert robot.applied is not None
    np.testing.assert_array_equal(vars(robot.applied.command)["finger_delta"], 0.0)
    free = GoalRobotEnv(robot, make_task("pick_and_place"))
    free.reset(seed=0)
    free.step(np.array([0.0, 0.0, 0.0, -1.0]))
    np.testing.assert_array_equal(vars(robot.applied.command)["finger_delta"], -1.0)


def assert_held(env: GoalRobotEnv, robot: FakeRobot) -> None:
    assert not robot.is_armed
    assert robot.calls[-1] == "hold"
    with pytest.raises(gym.error.ResetNeeded):
        env.step(FORWARD)


@pytest.mark.parametrize(
    "action",
    [np.zeros(3), np.array(["a", "b", "c", "d"]), np.array([None] * 4), None],
    ids=["shape", "text", "objects", "none"],
)
def test_an_action_that_cannot_be_used_leaves_the_robot_held(
    env: GoalRobotEnv, robot: FakeRobot, action: np.ndarray
) -> None:
    env.reset(seed=0)
    with pytest.raises((TypeError, ValueError)):
        env.step(action)
    assert "advance" not in robot.calls
    assert_held(env, robot)


def fail_in(
    monkeypatch: pytest.MonkeyPatch,
    owner: object,
    name: str,
    error: BaseException | type[BaseException],
) -> None:
    def failing(*_: object) -> None:
        raise error

    monkeypatch.setattr(owner, name, failing)


@pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt])
@pytest.mark.parametrize("where", ["observation", "is_success", "compute_reward", "achieved_goal"])
def test_an_error_of_the_task_in_a_step_leaves_the_robot_held(
    env: GoalRobotEnv,
    robot: FakeRobot,
    monkeypatch: pytest.MonkeyPatch,
    where: str,
    error: type[BaseException],
) -> None:
    env.reset(seed=0)
    owner = env.task if where in {"observation", "is_success"} else env.task.goal_model
    fail_in(monkeypatch, owner, where, error)
    with pytest.raises(error):
        env.step(FORWARD)
    assert_held(env, robot)


@pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt])
@pytest.mark.parametrize("where", ["observation", "sample_goal", "achieved_goal"])
def test_an_error_of_the_task_in_a_reset_leaves_the_robot_held(
    env: GoalRobotEnv,
    robot: FakeRobot,
    monkeypatch: pytest.MonkeyPatch,
    where: str,
    error: type[BaseException],
) -> None:
    owner = env.task if where == "observation" else env.task.goal_model
    fail_in(monkeypatch, owner, where, error)
    with pytest.raises(error):
        env.reset(seed=0)
    assert_held(env, robot)


def test_a_seed_that_is_refused_leaves_the_robot_held(env: GoalRobotEnv, robot: FakeRobot) -> None:
    env.reset(seed=0)
    with pytest.raises(gym.error.Error, match="-1"):
        env.reset(seed=-1)
    assert_held(env, robot)


def test_a_robot_that_cannot_be_held_needs_a_reset(env: GoalRobotEnv, robot: FakeRobot) -> None:
    env.reset(seed=0)
    robot.failing = {"advance", "hold"}
    with pytest.raises(OSError, match="advance failed") as error:
        env.step(FORWARD)
    assert error.value.__notes__ == ["fake could not be held either: OSError('hold failed')"]
    assert not robot.is_armed
    robot.failing = set()
    with pytest.raises(gym.error.ResetNeeded):
        env.step(FORWARD)


@pytest.mark.parametrize("cause", ["unseen", "expired", "not applied"])
def test_a_link_that_is_too_slow_is_named(env: GoalRobotEnv, robot: FakeRobot, cause: str) -> None:
    env.reset(seed=0)
    robot.lost_ticks = 2 * (cause == "unseen")
    robot.frozen = cause == "not applied"

    def step() -> None:
        if cause == "expired":
            robot.clock.advance_ns(3 * PERIOD_NS)
        env.step(FORWARD)

    step()
    step()
    with pytest.raises(LinkTooSlow, match=r"3 of these 3 .*iher-robot doctor"):
        step()
    assert_held(env, robot)


def test_a_controller_without_a_solution_is_not_attributed_to_the_link(
    env: GoalRobotEnv, robot: FakeRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    env.reset(seed=0)
    robot.lost_ticks = 1
    env.step(FORWARD)
    robot.lost_ticks = 0

    def no_solution(*_: object) -> None:
        raise NoSolution("an arm in a knot")

    monkeypatch.setattr(env.controller, "command", no_solution)
    env.step(FORWARD)
    with pytest.raises(EpisodeAborted, match="3 invalid ticks, allowed: 2; an arm") as error:
        env.step(FORWARD)
    assert not isinstance(error.value, LinkTooSlow)


def test_ticks_missed_in_the_aborting_step_are_charged(env: GoalRobotEnv, robot: FakeRobot) -> None:
    class LosesTicks(Recorder):
        def start(self, start: EpisodeStart) -> None:
            super().start(start)
            self.begun = robot.seq
            robot.lost_ticks = 3

        def abort(self, error: EpisodeAborted) -> None:
            super().abort(error)
            self.error, self.seq = error, robot.seq

    recorder = LosesTicks()
    run_episode(env, RandomActor(0), recorder, seed=0, ticks=50)
    assert isinstance(recorder.error, LinkTooSlow)
    assert recorder.ticks == recorder.seq - recorder.begun == 12


@pytest.mark.parametrize("kind", [LinkLost, LeaseRefused])
@pytest.mark.parametrize("hook", ["_apply", "_advance", "_read"])
def test_a_robot_lost_in_a_step_aborts_the_episode_and_is_reconnected(
    env: GoalRobotEnv,
    robot: FakeRobot,
    monkeypatch: pytest.MonkeyPatch,
    hook: str,
    kind: type[Exception],
) -> None:
    env.reset(seed=0)
    with monkeypatch.context() as patch:
        fail_in(patch, robot, hook, kind("no answer in 1 s"))
        with pytest.raises(EpisodeAborted, match="no answer in 1 s") as error:
            env.step(FORWARD)
    assert isinstance(error.value.__cause__, kind)
    assert not robot.is_armed
    assert robot.calls[-2:] == ["hold", "close"]
    env.reset(seed=0)
    assert env.step(FORWARD)[4]["tick_valid"]


@pytest.mark.parametrize("kind", [LinkLost, LeaseRefused])
def test_a_robot_lost_in_a_reset_is_disconnected(
    env: GoalRobotEnv, robot: FakeRobot, monkeypatch: pytest.MonkeyPatch, kind: type[Exception]
) -> None:
    with monkeypatch.context() as patch:
        fail_in(patch, robot, "_prepare_to_arm", kind("no answer"))
        with pytest.raises(kind, match="no answer"):
            env.reset(seed=0)
    assert not robot.is_open
    env.reset(seed=0)
    assert robot.is_armed


def test_a_lost_robot_that_cannot_be_held_raises_the_first_error(
    env: GoalRobotEnv, robot: FakeRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    env.reset(seed=0)
    robot.failing = {"hold"}
    fail_in(monkeypatch, robot, "_advance", LinkLost("no answer"))
    with pytest.raises(EpisodeAborted, match="no answer") as error:
        env.step(FORWARD)
    assert "hold failed" in error.value.__notes__[0]
    robot.failing = set()
