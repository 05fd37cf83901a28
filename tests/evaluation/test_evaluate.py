"""Which policies an evaluation takes, and what it says of those that it should not compare."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from scipy.stats import binomtest

from drivers.canonical import digest
from iher_robot.config.robot import choose_robot
from iher_robot.env.goal_env import EpisodeAborted, GoalRobotEnv
from iher_robot.errors import UserError
from iher_robot.evaluation.compatibility import body_differences, check_fit, load_trained_policy
from iher_robot.evaluation.evaluate import evaluate, wilson_interval
from iher_robot.evaluation.policy_file import PolicyFile, save_policy
from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.goal_model import Shapes
from iher_robot.learning.policy import Policy

Save = Callable[..., Path]
ROBOT = "fetch-mocap"


@pytest.fixture
def save(tmp_path: Path) -> Save:
    """Save a policy for Reach, untrained, whose robot may differ from the one there is."""

    def write(**changes: Any) -> Path:
        with choose_robot("mujoco", ROBOT).make_env("reach") as env:
            interface = env.policy_interface()
            shapes = Shapes(env.task.layout.obs_dim, env.task.goal_dim, 4, 50)
        policy = Policy.from_config(
            shapes,
            LearnerConfig(),
            generator=torch.Generator().manual_seed(0),
            device=torch.device("cpu"),
        )
        if changes:
            interface["spec"] = interface["spec"] | changes
            interface["interface_digest"] = digest(changes)
        path = tmp_path / "policy.pt"
        save_policy(path, PolicyFile(policy=policy.snapshot(), trained={}, **interface))
        return path

    return write


OTHER: dict[str, Any] = {
    "command_kinds": ["thoughts"],
    "action": {"position_scale_m": 0.01, "gripper_scale_m": 1.0, "frame": "world", "names": []},
}
DIFFERENCES = ('["ee_delta"], not ["thoughts"]', "action.position_scale_m: 0.05, not 0.01")


def test_another_interface_is_refused_with_every_difference_and_the_way_round(save: Save) -> None:
    with pytest.raises(UserError, match="another interface") as error:
        evaluate(save(**OTHER), episodes=1, robot=ROBOT)
    for part in (*DIFFERENCES, "--accept-interface"):
        assert part in str(error.value)


def test_another_interface_that_is_accepted_is_run_and_listed(save: Save) -> None:
    result = evaluate(save(**OTHER), episodes=2, robot=ROBOT, accept_interface=True)

    assert result.episodes == 2
    for part in DIFFERENCES:
        assert [part in warning for warning in result.warnings].count(True) == 1
        assert part in result.summary()


def test_a_physical_robot_takes_no_other_interface_whatever_is_accepted(save: Save) -> None:
    actor = load_trained_policy(save(**OTHER))
    with choose_robot("mujoco", ROBOT).make_env("reach") as env:
        check_fit(actor, env, accept_interface=True)
        spec = dataclasses.replace(env.driver.spec, physical=True, hold_on_silence_s=0.1)
        env.driver._spec = spec
        with pytest.raises(UserError, match="another interface") as error:
            check_fit(actor, env, accept_interface=True)
    assert "--accept-interface" not in str(error.value)


def test_the_official_environment_lists_what_differs(save: Save) -> None:
    result = evaluate(save(**OTHER), episodes=1, official=True)
    assert any(DIFFERENCES[0] in warning for warning in result.warnings)
    assert not evaluate(save(), episodes=1, official=True).warnings


def test_the_same_interface_needs_no_flag_and_no_warning(save: Save) -> None:
    result = evaluate(save(), episodes=1, robot=ROBOT)
    assert not result.warnings
    assert "reach in mujoco fetch-mocap: " in result.summary()


def test_a_film_of_a_policy_that_is_refused_leaves_no_file(
    save: Save, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "egl")
    with pytest.raises(UserError, match="another interface"):
        evaluate(save(**OTHER), episodes=1, robot=ROBOT, video=tmp_path / "film.mp4")
    assert not (tmp_path / "film.mp4").exists()


def test_an_episode_that_is_aborted_is_a_failure(
    save: Save, monkeypatch: pytest.MonkeyPatch
) -> None:
    step, steps = GoalRobotEnv.step, 0

    def stopped_at_the_goal(self: GoalRobotEnv, action: Any) -> Any:
        nonlocal steps
        steps += 1
        if steps == 10:
            raise EpisodeAborted
        *rest, info = step(self, action)
        return *rest, info | {"is_success": 1.0}

    monkeypatch.setattr(GoalRobotEnv, "step", stopped_at_the_goal)
    assert evaluate(save(), episodes=2, robot=ROBOT).successes == 1


def test_another_body_is_named_by_what_differs_and_nothing_else(save: Save) -> None:
    actor = load_trained_policy(save())
    with choose_robot("mujoco", ROBOT).make_env("reach") as env:
        env.driver._spec = dataclasses.replace(env.driver.spec, calibration_id="new")
        (warning,) = check_fit(actor, env)
        assert warning.endswith("it differs in calibration_id")
        found = body_differences(actor.file, env.driver.spec)
    assert found == ['calibration_id: "new", not "simulated"']


def test_the_official_environment_has_no_network(save: Save) -> None:
    with pytest.raises(UserError, match=r"--connect is 'tcp/a:1'.*official"):
        evaluate(save(), official=True, connect=["tcp/a:1"])


def test_the_official_environment_has_no_robot_file(save: Save) -> None:
    with pytest.raises(UserError, match=r"robot is 'fetch'.*--robot"):
        evaluate(save(), official=True, robot="fetch")


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0000, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_the_interval_of_a_rate_is_the_published_one(
    successes: int, trials: int, low: float, high: float
) -> None:
    # Score method without a correction for continuity, 95 %: R. G. Newcombe, "Two-sided confidence
    # intervals for the single proportion", Statistics in Medicine 17 (1998), table I, method 3.
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=5e-5)


@pytest.mark.parametrize("confidence", [0.9, 0.95, 0.99])
@pytest.mark.parametrize("trials", [1, 2, 10, 100, 1000])
def test_the_interval_of_a_rate_is_that_of_scipy(trials: int, confidence: float) -> None:
    for successes in {0, 1, trials // 3, trials // 2, trials - 1, trials}:
        known = binomtest(successes, trials).proportion_ci(confidence, method="wilson")

        low, high = wilson_interval(successes, trials, confidence)

        assert (low, high) == pytest.approx((known.low, known.high), abs=1e-12)
        assert 0 <= low <= successes / trials <= high <= 1
