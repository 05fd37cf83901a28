"""Whole training runs on the simulated robot, small ones."""

from __future__ import annotations

import inspect
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest
import torch

from drivers.rendering import CannotRender
from iher_robot.config import robot as robot_module
from iher_robot.env.goal_env import EpisodeAborted, GoalRobotEnv, ResetFailed, make_env
from iher_robot.errors import UserError
from iher_robot.evaluation import success_rate as success_rate_module
from iher_robot.evaluation.evaluate import evaluate
from iher_robot.evaluation.policy_file import load_policy
from iher_robot.evaluation.success_rate import Evaluation
from iher_robot.rollout.episode import run_episode
from iher_robot.rollout.recorder import Recorder
from iher_robot.storage.accounts import read_accounts
from iher_robot.storage.checkpoint import load_checkpoint
from iher_robot.storage.episode_reader import EpisodeReader
from iher_robot.storage.ledger import Ledger
from iher_robot.training.display import TrainingDisplay
from iher_robot.training.train import resume, train
from tests.conftest import WholeRun
from tests.small_runs import (
    EPOCH_MINUTES,
    TINY,
    Interruption,
    interruption,
    leave_out_the_simulator,
    metrics,
    motion_ticks,
    run,
    stored_ticks,
)


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def test_the_budget_is_spent_to_the_last_tick_and_every_tick_is_kept(tmp_path: Path) -> None:
    # 75 ticks: one whole episode and half of another.
    result = run(tmp_path / "run", 0.05)
    assert motion_ticks(tmp_path / "run") == 75
    assert stored_ticks(tmp_path / "run") == 75
    assert [len(s.episode) for s in EpisodeReader(tmp_path / "run" / "episodes")] == [50, 25]
    assert result.robot_minutes == pytest.approx(0.05)


def test_imagined_and_evaluation_episodes_cost_nothing_and_are_not_stored(
    whole_run: WholeRun,
) -> None:
    out = whole_run(EPOCH_MINUTES)
    (row,) = metrics(out)
    assert row["imagined_transitions"] == 2 * 2 * 50
    assert row["real_transitions"] == stored_ticks(out) == 100
    assert read_accounts(out / "ledger.sqlite").spent["evaluation"] == 0


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"overrides": ["learner.imagination.regenerate=false"]},
        {"overrides": ["learner.imagination.branch_ticks=3"]},
        {"algo": "her"},
        {
            "task": "push",
            "preset": "default",
            "overrides": [
                "learner.schedule.real_rollouts=2",
                "learner.schedule.updates_per_step=0.1",
                "learner.contact.updates_per_step=0.5",
                "evaluation.every_epochs=1",
            ],
        },
    ],
)
def test_a_run_interrupted_between_epochs_ends_as_one_that_was_not(
    tmp_path: Path, settings: dict[str, Any]
) -> None:
    overrides = settings.pop("overrides", [])
    run(tmp_path / "whole", 3 * EPOCH_MINUTES, *overrides, **settings)
    with interruption(TrainingDisplay, "epoch", call=2):
        run(tmp_path / "parts", 3 * EPOCH_MINUTES, *overrides, **settings)
    assert len(metrics(tmp_path / "parts")) == 2
    resume(tmp_path / "parts", display=False)
    assert metrics(tmp_path / "parts") == metrics(tmp_path / "whole")
    parts, whole = (
        torch.load(tmp_path / name / "policy.pt", weights_only=True)["policy"]
        for name in ("parts", "whole")
    )
    for name, weight in whole["actor"].items():
        assert torch.equal(parts["actor"][name], weight), name


def test_a_run_interrupted_in_an_episode_loses_and_recounts_nothing(tmp_path: Path) -> None:
    # An epoch is 100 ticks of collection and 100 of evaluation.
    with interruption(Recorder, "before_tick", call=231):
        run(tmp_path / "run", 2 * EPOCH_MINUTES)
    assert [len(s.episode) for s in EpisodeReader(tmp_path / "run" / "episodes")] == [50, 50, 30]
    assert motion_ticks(tmp_path / "run") == 130
    resume(tmp_path / "run", display=False)
    assert motion_ticks(tmp_path / "run") == 200
    rows = metrics(tmp_path / "run")
    assert rows[-1]["real_transitions"] == stored_ticks(tmp_path / "run") == 200
    assert [row["epoch"] for row in rows] == [1, 2, 3]


def test_the_tick_in_flight_counts(tmp_path: Path) -> None:
    with interruption(GoalRobotEnv, "step", call=31):
        run(tmp_path / "run", EPOCH_MINUTES)
    assert stored_ticks(tmp_path / "run") == 30
    assert motion_ticks(tmp_path / "run") == 31


def test_an_aborted_episode_is_charged_and_kept_and_the_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original, calls = GoalRobotEnv.step, 0

    def abort_once(self: GoalRobotEnv, action: Any) -> Any:
        nonlocal calls
        calls += 1
        outcome = original(self, action)
        if calls == 21:
            self.hold()
            raise EpisodeAborted("six invalid ticks")
        return outcome

    monkeypatch.setattr(GoalRobotEnv, "step", abort_once)
    run(tmp_path / "run", 0.0474)  # 71 ticks
    lengths = [len(stored.episode) for stored in EpisodeReader(tmp_path / "run" / "episodes")]
    assert lengths == [20, 50]
    assert motion_ticks(tmp_path / "run") == 21 + 50
    assert metrics(tmp_path / "run")[-1]["real_transitions"] == 70


def test_an_episode_without_a_whole_tick_does_not_stop_a_resume(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original, calls = GoalRobotEnv.step, 0

    def abort_first(self: GoalRobotEnv, action: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == 1:
            self.hold()
            raise EpisodeAborted("stopped at once")
        return original(self, action)

    monkeypatch.setattr(GoalRobotEnv, "step", abort_first)
    run(tmp_path / "run", EPOCH_MINUTES)  # 100 ticks, of which the first is lost
    assert (motion_ticks(tmp_path / "run"), stored_ticks(tmp_path / "run")) == (100, 99)
    resume(tmp_path / "run", display=False)
    assert motion_ticks(tmp_path / "run") == 100


def test_evaluation_on_a_robot_is_kept_and_charged_to_its_own_account(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    leave_out_the_simulator(monkeypatch)
    run(tmp_path / "run", EPOCH_MINUTES, "evaluation.robot_episodes=2")
    kept = [(s.account, s.epoch) for s in EpisodeReader(tmp_path / "run" / "episodes")]
    assert kept == [("motion", 1)] * 2 + [("evaluation", 1)] * 2
    with Ledger(tmp_path / "run" / "ledger.sqlite") as ledger:
        assert (ledger.spent_ticks("motion"), ledger.spent_ticks("evaluation")) == (100, 100)


def test_a_robot_that_cannot_be_reset_is_charged_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(self: GoalRobotEnv, **_: Any) -> Any:
        raise ResetFailed("the block fell off the table")

    monkeypatch.setattr(GoalRobotEnv, "reset", fail)
    with pytest.raises(UserError, match="fell off"):
        run(tmp_path / "run", EPOCH_MINUTES)
    assert motion_ticks(tmp_path / "run") == 0


@pytest.mark.parametrize("method", ["step", "reset"])
def test_robots_end_disarmed_and_closed_whatever_happens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    made: list[GoalRobotEnv] = []

    def remember(*args: Any, **options: Any) -> GoalRobotEnv:
        made.append(make_env(*args, **options))
        return made[-1]

    monkeypatch.setattr(robot_module, "make_env", remember)
    with interruption(GoalRobotEnv, method, call=2):
        run(tmp_path / "run", EPOCH_MINUTES)
    assert made
    assert not any(env.driver.is_armed or env.driver.is_open for env in made)


def test_a_run_stops_when_two_evaluations_in_a_row_succeed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcomes = iter([1, 0, 1, 1, 0, 0])
    monkeypatch.setattr(
        success_rate_module,
        "run_evaluation",
        lambda *args: Evaluation(successes=next(outcomes), count=1, episodes=[]),
    )
    result = run(tmp_path / "run", 6 * EPOCH_MINUTES, until_success=1.0)
    assert result.epochs == 4
    assert result.robot_minutes == pytest.approx(4 * 100 * 0.04 / 60)


def test_a_finished_run_can_be_resumed_and_spends_nothing(tmp_path: Path) -> None:
    first = run(tmp_path / "run", EPOCH_MINUTES)
    again = resume(tmp_path / "run", display=False)
    assert motion_ticks(tmp_path / "run") == 100
    assert again.success_rate == first.success_rate


def test_the_baseline_imagines_nothing_and_evaluates_at_its_end(tmp_path: Path) -> None:
    run(tmp_path / "run", 2 * EPOCH_MINUTES, algo="her")
    rows = metrics(tmp_path / "run")
    assert [row["imagined_transitions"] for row in rows] == [0, 0]
    assert ["success" in row for row in rows] == [False, True]
    assert "model_error_1" not in rows[-1]


def test_a_policy_does_the_same_on_the_driver_and_in_the_official_environment(
    tmp_path: Path,
) -> None:
    result = run(
        tmp_path / "run",
        EPOCH_MINUTES,
        "learner.schedule.cycles=10",
        "learner.schedule.batches=40",
        robot="fetch-mocap",  # whose physics is the official one
    )
    ours = evaluate(result.policy, episodes=20, robot="fetch-mocap")
    official = evaluate(result.policy, episodes=20, official=True)
    assert ours.successes == official.successes
    assert 0 < ours.successes < 20  # else the comparison shows nothing
    assert not ours.warnings


def test_a_second_learner_cannot_spend_the_same_budget(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refused: list[str] = []

    def resume_meanwhile(self: TrainingDisplay, row: object) -> None:
        with pytest.raises(UserError) as error:
            resume(tmp_path / "run", display=False)
        refused.append(str(error.value))

    monkeypatch.setattr(TrainingDisplay, "epoch", resume_meanwhile)
    run(tmp_path / "run", EPOCH_MINUTES)
    assert len(refused) == 1
    assert "in use" in refused[0]


def _lose_ledger(run: Path) -> None:
    for part in run.glob("ledger.*"):
        part.unlink()
    Ledger(run / "ledger.sqlite").close()


def _edit_config(run: Path) -> None:
    text = (run / "config.yaml").read_text()
    (run / "config.yaml").write_text(text.replace("budget_minutes: 0.2", "budget_minutes: 99.0"))


DAMAGE: dict[str, Callable[[Path], object]] = {
    "ledger.sqlite": _lose_ledger,
    "config.yaml": _edit_config,
    "checkpoint.pt": lambda run: (run / "checkpoint.pt").unlink(),
    "episodes": lambda run: (run / "episodes" / "episode-000003.npz").unlink(),
    "episode-000001.npz": lambda run: (run / "episodes" / "episode-000001.npz").write_bytes(b"x"),
}


@pytest.fixture(scope="module")
def two_epochs_of_three(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stopped") / "run"
    with interruption(TrainingDisplay, "epoch", call=2):
        run(folder, 0.2001)
    return folder


@pytest.mark.parametrize("part", DAMAGE)
def test_a_run_that_lost_a_part_is_refused_and_left_as_it_is(
    tmp_path: Path, two_epochs_of_three: Path, part: str
) -> None:
    folder = shutil.copytree(two_epochs_of_three, tmp_path / "run")
    DAMAGE[part](folder)
    watched = ("metrics.jsonl", "provenance.json", "policy.pt")
    before = {name: (folder / name).read_bytes() for name in watched}
    with pytest.raises(UserError, match=re.escape(part)):
        resume(folder, display=False)
    assert {name: (folder / name).read_bytes() for name in watched} == before


def test_lost_metrics_come_back_from_the_checkpoint(
    tmp_path: Path, two_epochs_of_three: Path
) -> None:
    folder = shutil.copytree(two_epochs_of_three, tmp_path / "run")
    (folder / "metrics.jsonl").write_bytes(b"junk")
    resume(folder, display=False)
    assert metrics(folder)[:2] == metrics(two_epochs_of_three)
    assert [row["epoch"] for row in metrics(folder)] == [1, 2, 3]


@pytest.mark.parametrize(
    ("function", "line", "stored"),
    [
        (run_episode, "after, _, _, _, info = env.step", 7),
        (run_episode, "observer.after_tick", 7),
        (Recorder.after_tick, "self.success = ", 8),
    ],
)
def test_an_interrupt_within_a_tick_keeps_whole_ticks_and_counts_that_one(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    function: Callable[..., None],
    line: str,
    stored: int,
) -> None:
    source, first = inspect.getsourcelines(function)
    number = first + next(i for i, text in enumerate(source) if line in text)
    before_tick = Recorder.before_tick

    def trace(frame: FrameType, event: str, _: object) -> Any:
        if frame.f_code is not function.__code__:
            return None
        if event == "line" and frame.f_lineno == number:
            sys.settrace(None)
            raise Interruption
        return trace

    def traced(self: Recorder, observation: Any, action: Any) -> None:
        if self.ticks == 7:
            sys.settrace(trace)
            loop = sys._getframe(1)
            loop.f_trace = trace
        before_tick(self, observation, action)

    monkeypatch.setattr(Recorder, "before_tick", traced)
    with pytest.raises(Interruption):
        run(tmp_path / "run", EPOCH_MINUTES)
    assert stored_ticks(tmp_path / "run") == stored
    assert motion_ticks(tmp_path / "run") == 8


def test_bad_settings_leave_no_folder(tmp_path: Path) -> None:
    for options in (
        {"minutes": 0.0},
        {"minutes": float("nan")},
        {"minutes": 1e-6},
        {"minutes": 1.0, "driver": "mojoco"},
    ):
        with pytest.raises(ValueError, match=r"budget|mojoco"):
            run(tmp_path / "run", options.pop("minutes"), **options)  # type: ignore[arg-type]
    assert not (tmp_path / "run").exists()


def test_the_display_changes_nothing(tmp_path: Path, whole_run: WholeRun) -> None:
    quiet = whole_run(EPOCH_MINUTES)
    train(
        task="reach",
        preset="paper",
        budget_minutes=EPOCH_MINUTES,
        overrides=TINY,
        out=tmp_path / "shown",
        until_success=None,
        device="cpu",
    )
    assert metrics(quiet) == metrics(tmp_path / "shown")


def test_a_run_goes_on_with_the_robot_that_it_began_with(tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text("actuation: mocap")
    with interruption(TrainingDisplay, "epoch", call=1):
        run(tmp_path / "run", 2 * EPOCH_MINUTES, robot=str(mine))
    mine.write_text("actuation: changed since")

    result = resume(tmp_path / "run", display=False)

    trained = load_policy(result.policy).trained
    assert (trained["driver"], trained["robot"]) == ("mujoco", str(mine))
    assert trained["robot_options"] == {"actuation": "mocap"}
    assert f"--robot {mine}" in result.summary()


def test_a_film_shows_the_final_policy_and_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    imageio = pytest.importorskip("imageio.v2")
    monkeypatch.setenv("MUJOCO_GL", "egl")
    grey = np.full((48, 64, 3), 128, np.uint8)
    monkeypatch.setattr(GoalRobotEnv, "render", lambda self: grey)  # graphics may be missing

    filmed = run(tmp_path / "filmed", EPOCH_MINUTES, video=True)
    plain = run(tmp_path / "plain", EPOCH_MINUTES)

    assert filmed.video == tmp_path / "filmed" / "final.mp4"
    assert str(filmed.video) in filmed.summary()
    # An episode: the start, 50 ticks, and the last picture for 0.6 s more.
    assert filmed.final is not None
    pictures = len(list(imageio.get_reader(filmed.video).iter_data()))
    assert pictures == filmed.final.episodes * (1 + 50 + 15)
    assert plain.video is None
    assert not (tmp_path / "plain" / "final.mp4").exists()
    assert metrics(tmp_path / "filmed") == metrics(tmp_path / "plain")


def test_a_film_that_cannot_be_made_is_refused_before_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "egl")

    def fail(self: GoalRobotEnv) -> None:
        raise CannotRender("nothing draws here")

    monkeypatch.setattr(GoalRobotEnv, "render", fail)
    with pytest.raises(CannotRender):
        run(tmp_path / "run", EPOCH_MINUTES, video=True)
    assert not (tmp_path / "run").exists()


def test_the_running_mean_is_what_is_evaluated_and_kept(tmp_path: Path) -> None:
    result = run(tmp_path / "run", EPOCH_MINUTES, "learner.ddpg.policy_average=0.01")
    checkpoint = load_checkpoint(tmp_path / "run" / "checkpoint.pt")
    assert checkpoint is not None
    kept, learner = load_policy(result.policy).policy["actor"], checkpoint["learner"]
    for name, weights in learner["ddpg"]["mean_actor"].items():
        assert torch.equal(kept[name], weights)
        assert not torch.equal(kept[name], learner["policy"]["actor"][name])


def test_seeds_decide_a_run(tmp_path: Path, whole_run: WholeRun) -> None:
    one, same, other = whole_run(EPOCH_MINUTES), tmp_path / "same", tmp_path / "other"
    run(same, EPOCH_MINUTES, seed=0)
    run(other, EPOCH_MINUTES, seed=2)
    assert metrics(one) == metrics(same)
    assert metrics(one) != metrics(other)
    first, second = (next(iter(EpisodeReader(out / "episodes"))).episode for out in (one, other))
    assert not np.array_equal(first.desired_goal, second.desired_goal)
