"""Training runs whose learner computes beside the robot."""

from __future__ import annotations

import gc
import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import torch

from iher_robot.config.options import load_config
from iher_robot.config.run import read_config
from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.errors import UserError
from iher_robot.evaluation.policy_file import PolicyFile, save_policy
from iher_robot.learning.policy import Policy
from iher_robot.rollout.actor import PolicyActor
from iher_robot.rollout.episode import run_episode
from iher_robot.rollout.recorder import Recorder
from iher_robot.rollout.robot import RobotEpisodes
from iher_robot.storage.episode_reader import EpisodeReader
from iher_robot.storage.ledger import Ledger
from iher_robot.training import loop as loop_module
from iher_robot.training.display import TrainingDisplay
from iher_robot.training.learners import asynchronous as learner_process_part_module
from iher_robot.training.learners.asynchronous import AsyncLearner, LearnerProcess
from iher_robot.training.recovery import Restored
from iher_robot.training.setup import make_learner, open_training_setup
from iher_robot.training.train import resume, train
from tests.forked import run_forked
from tests.served.served_robot import PATIENT, ServedRobot, eventually, is_running
from tests.small_runs import (
    TINY,
    interruption,
    leave_out_the_simulator,
    metrics,
    motion_ticks,
    run,
    stored_ticks,
)

MINUTES = 0.15001  # 225 ticks: two epochs of 100 ticks and a quarter of one
TICKS = 225
DIVERGES = "raise FloatingPointError('the dynamics models diverged')"
DIES = "os.kill(os.getpid(), 9)"
FAILS = "raise RuntimeError('a mistake')"
KILLED = """
import os, signal, sys
from pathlib import Path
import pytest
from iher_robot.env.goal_env import GoalRobotEnv
from tests.small_runs import run
from tests.training.learners.test_asynchronous import _patch_learner

_patch_learner(pytest.MonkeyPatch(), "time.sleep(60)")
original, calls = GoalRobotEnv._run_tick, 0

def killed(*args):
    global calls
    calls += 1
    if calls == 130:
        me = os.getpid()
        children = Path(f"/proc/{me}/task/{me}/children").read_text()
        Path(sys.argv[2]).write_text(children)
        os.kill(me, signal.SIGKILL)
    return original(*args)

GoalRobotEnv._run_tick = killed
run(Path(sys.argv[1]), 0.15001, asynchronous=True)
"""


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def _patch_learner(monkeypatch: pytest.MonkeyPatch, before: str) -> None:
    """Do something in the learner's process whenever it is about to learn."""
    patched = f"""
import time
from iher_robot.learning.learner import Learner
original, calls = Learner.learn, 0
def learn(self, progress):
    global calls
    calls += 1
    {before}
    return original(self, progress)
Learner.learn = learn
"""
    program = learner_process_part_module.PROGRAM.replace("main(int", patched + "main(int")
    monkeypatch.setattr(learner_process_part_module, "PROGRAM", program)


@contextmanager
def acting_epochs() -> Iterator[list[tuple[int, int]]]:
    """Note the epoch of each episode, and the epoch after which the policy was as it acts in it."""
    noted: list[tuple[int, int]] = []
    made: dict[float, int] = {}
    run_one = RobotEpisodes.run

    def sign(snapshot: dict[str, Any]) -> float:
        return float(sum(weight.double().sum() for weight in snapshot["actor"].values()))

    def noting(self: RobotEpisodes, account: Any, reserve: Any, policy: Policy, **more: Any) -> Any:
        acts = made.setdefault(sign(policy.snapshot()), 0)
        noted.append((more["epoch"], acts))
        return run_one(self, account, reserve, policy, **more)

    def saving(path: Path, file: PolicyFile) -> None:
        made.setdefault(sign(file.policy), file.trained["epochs"])
        save_policy(path, file)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RobotEpisodes, "run", noting)
        patch.setattr(loop_module, "save_policy", saving)
        yield noted


@pytest.fixture(scope="module")
def acted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[tuple[int, int]]]:
    """A run that nothing interrupted, and which policies acted in it."""
    out = tmp_path_factory.mktemp("async") / "whole"
    with acting_epochs() as noted:
        run(out, MINUTES, asynchronous=True)
    return out, noted


@pytest.fixture(scope="module")
def whole(acted: tuple[Path, list[tuple[int, int]]]) -> Path:
    return acted[0]


def same(one: Path, other: Path) -> bool:
    """Whether two runs ended alike, to the last digit."""
    actors = [
        torch.load(out / "policy.pt", weights_only=True)["policy"]["actor"] for out in (one, other)
    ]
    weights = all(torch.equal(actors[0][name], actors[1][name]) for name in actors[1])
    return weights and metrics(one) == metrics(other)


def test_the_same_budget_is_spent_and_every_tick_is_learned_from(
    tmp_path: Path, whole: Path
) -> None:
    run(tmp_path / "in turn", MINUTES)
    assert motion_ticks(whole) == motion_ticks(tmp_path / "in turn") == TICKS
    assert metrics(whole)[-1]["real_transitions"] == stored_ticks(whole) == TICKS
    in_turn, beside = metrics(tmp_path / "in turn"), metrics(whole)
    assert [list(row) for row in beside] == [list(row) for row in in_turn]
    for name in ("epoch", "robot_minutes", "episodes", "updates"):
        assert [row[name] for row in beside] == [row[name] for row in in_turn], name
    assert beside[0] == in_turn[0], "both begin with the same policy"
    assert read_config(whole / "config.yaml").asynchronous


def test_the_robot_is_one_epoch_ahead_and_never_more(
    acted: tuple[Path, list[tuple[int, int]]],
) -> None:
    # (epoch, epoch whose policy acts)
    assert acted[1] == [(1, 0), (1, 0), (2, 0), (2, 0), (3, 1)]


@pytest.mark.parametrize(
    ("owner", "name", "call"), [(TrainingDisplay, "epoch", 1), (GoalRobotEnv, "reset", 4)]
)
def test_a_run_interrupted_between_episodes_ends_as_one_that_was_not(
    tmp_path: Path, whole: Path, owner: type, name: str, call: int
) -> None:
    with interruption(owner, name, call):
        run(tmp_path / "parts", MINUTES, asynchronous=True)
    assert len(metrics(tmp_path / "parts")) < 2
    resume(tmp_path / "parts", display=False)
    assert same(tmp_path / "parts", whole)


@pytest.mark.parametrize(
    ("how", "sentence"),
    [
        (DIES, "the learner's process ended by itself with signal SIGKILL; .*--resume"),
        (FAILS, "the learner's process ended by itself with exit code 1, see its messages above"),
        (DIVERGES, "learning stopped in epoch 2: the dynamics models diverged"),
    ],
)
def test_a_learner_that_ends_ends_the_run_with_a_sentence_and_costs_nothing(
    tmp_path: Path, whole: Path, how: str, sentence: str
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        _patch_learner(patch, f"if calls == 2:\n        {how}")
        with pytest.raises(UserError, match=f"^{sentence}") as error:
            run(tmp_path / "run", MINUTES, asynchronous=True)
    assert "\n" not in str(error.value)
    lengths = [len(stored.episode) for stored in EpisodeReader(tmp_path / "run" / "episodes")]
    assert set(lengths[:4]) == {50}, "the episode under way was ended"
    if how == DIES:
        resume(tmp_path / "run", display=False)
        assert same(tmp_path / "run", whole)


def test_a_killed_run_leaves_no_process_and_loses_nothing(tmp_path: Path) -> None:
    out, children = tmp_path / "run", tmp_path / "children"
    done = run_forked(KILLED, str(out), str(children))
    assert done.returncode == -signal.SIGKILL, done.stderr
    (learner,) = map(int, children.read_text().split())
    try:
        assert eventually(lambda: not is_running(learner))
    finally:
        if is_running(learner):
            os.kill(learner, signal.SIGKILL)
    assert motion_ticks(out) == 130
    resume(out, display=False)
    assert (motion_ticks(out), stored_ticks(out)) == (TICKS, TICKS - 1)
    rows = metrics(out)
    assert [row["epoch"] for row in rows] == list(range(1, len(rows) + 1))
    assert rows[-1]["real_transitions"] == TICKS - 1


def test_a_run_that_lost_its_checkpoint_is_refused(tmp_path: Path, whole: Path) -> None:
    folder = shutil.copytree(whole, tmp_path / "run")
    (folder / "checkpoint.pt").unlink()
    with pytest.raises(UserError, match=r"checkpoint\.pt is missing or too old.*epoch 3"):
        resume(folder, display=False)


def test_data_of_earlier_runs_are_learned_from_before_the_robot_moves(
    tmp_path: Path, whole: Path
) -> None:
    with acting_epochs() as noted:
        run(tmp_path / "run", 0.1001, asynchronous=True, from_data=[whole])
    assert noted == [(2, 1), (2, 1), (3, 1)]
    rows = metrics(tmp_path / "run")
    assert (rows[0]["robot_minutes"], rows[0]["real_transitions"]) == (0, TICKS)
    assert rows[-1]["real_transitions"] == TICKS + 150


def test_a_robot_that_is_the_only_one_is_evaluated_with_the_policy_of_the_epoch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    leave_out_the_simulator(monkeypatch)
    run(tmp_path / "run", MINUTES, "evaluation.robot_episodes=1", asynchronous=True)
    kept = [(s.account, s.epoch) for s in EpisodeReader(tmp_path / "run" / "episodes")]
    motion = [epoch for account, epoch in kept if account == "motion"]
    assert motion == [1, 1, 2, 2, 3]
    evaluations = [at for at, (account, _) in enumerate(kept) if account == "evaluation"]
    assert [kept[at][1] for at in evaluations] == [1, 2, 3]
    # The policy after epoch 1 is evaluated while epoch 2, which it did not act in, is learned.
    assert evaluations == [4, 6, 7]
    with Ledger(tmp_path / "run" / "ledger.sqlite") as ledger:
        assert (ledger.spent_ticks("motion"), ledger.spent_ticks("evaluation")) == (TICKS, 150)
    rows = metrics(tmp_path / "run")
    assert all({"success", "model_error_1", "imagined_success"} <= row.keys() for row in rows)


def test_an_interrupt_ends_the_learner(tmp_path: Path) -> None:
    out = tmp_path / "run"
    command = [sys.executable, "-m", "iher_robot", "train", "--task", "reach", "--async"]
    command += ["--quiet", "--out", str(out), "--until-success", "off", "--budget-minutes", "9"]
    command += ["--set", "evaluation.episodes=1", "--set", "learner.schedule.updates_per_step=1"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert eventually((out / "checkpoint.pt").exists, 60.0)
            children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text()
            process.send_signal(signal.SIGTERM)
            _, printed = process.communicate(timeout=30.0)
        finally:
            process.kill()
    assert process.returncode == 143
    assert printed.startswith("iher-robot: interrupted; continue with: iher-robot train --resume")
    assert not [child for child in children.split() if is_running(int(child))]


def test_what_a_learner_on_another_device_made_acts_and_is_kept_whole(tmp_path: Path) -> None:
    class Silent(LearnerProcess):
        def start(self) -> None:
            pass

        def send(self, message: object) -> None:
            pass

    with open_training_setup(load_config("push", device="cpu", asynchronous=True)) as setup:
        there = make_learner(setup.config, setup.env.task, torch.device("cpu"))
        there.epoch = 7
        with torch.no_grad():
            next(iter(there.policy.actor.parameters())).add_(1.0)
        state = there.state_dict()
        state["generator"] = state["contact"]["generator"] = torch.zeros(16, dtype=torch.uint8)
        beside = AsyncLearner(setup, Silent(tmp_path), lambda *_: None)
        beside.begin(Restored(state, [], [], [], 0))
        acts = beside.learner.policy.snapshot()["actor"]
        assert beside.learner.epoch == 7
        assert torch.equal(acts["0.weight"], state["policy"]["actor"]["0.weight"])
        assert beside.state_dict() is state


def test_no_garbage_is_collected_between_two_ticks(request: pytest.FixtureRequest) -> None:
    collected: list[int] = []

    class Watched(Recorder):
        def before_tick(self, observation: Any, action: Any) -> None:
            collected.append(len(collections))
            garbage: list[Any] = [[] for _ in range(2000)]
            garbage.append(garbage)
            super().before_tick(observation, action)

    collections: list[str] = []

    def note(phase: str, _: object) -> None:
        collections.append(phase)

    gc.callbacks.append(note)
    request.addfinalizer(lambda: gc.callbacks.remove(note))
    with open_training_setup(load_config("reach", device="cpu", asynchronous=True)) as setup:
        policy = setup.learner.acting_policy(torch.device("cpu"))
        run_episode(setup.env, PolicyActor(policy), Watched(), seed=0, ticks=5)
    assert len(collected) == 5
    assert len(set(collected)) == 1
    assert gc.isenabled()


@pytest.mark.real_time
def test_a_slow_learner_delays_no_tick_of_a_served_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow_s = 3.0
    _patch_learner(monkeypatch, f"time.sleep({slow_s})")
    log, out = tmp_path / "ticks.jsonl", tmp_path / "run"
    with ServedRobot(tmp_path / "memory", *PATIENT, "--tick-log", str(log)) as served:
        result = train(
            task="reach",
            driver="zenoh",
            connect=[served.endpoint],
            preset="paper",
            budget_minutes=MINUTES,
            overrides=(*TINY, "evaluation.robot_episodes=1", "evaluation.every_epochs=9"),
            out=out,
            until_success=None,
            device="cpu",
            asynchronous=True,
            display=False,
        )
    # A busy machine may cost some ticks; waiting for the learner would cost 75 at once.
    longest_gap = max(int(stored.elapsed.max()) for stored in EpisodeReader(out / "episodes"))
    assert longest_gap < slow_s * 25 / 3
    assert re.search(r"off the control period by .* ms", result.summary())
    with Ledger(out / "ledger.sqlite") as ledger:
        idle = ledger.spent_ticks("idle")
    assert idle > 2 * slow_s * 25 - 50, "the robot waits for the learner twice"
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    armed = [line["armed"] for line in lines]
    longest = max(len(list(group)) for key, group in itertools.groupby(armed) if key)
    assert longest < 2 * 50, "between two episodes it is disarmed"
