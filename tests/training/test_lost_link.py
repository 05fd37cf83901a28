"""Training runs on a robot that is lost, taken or stopped, and comes back or does not."""

from __future__ import annotations

import dataclasses
import json
import sqlite3
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch

from drivers import DriverError, LeaseRefused, LinkLost, RobotSpec, SimulatedClock
from iher_robot.config.options import load_config
from iher_robot.env import goal_env as goal_env_module
from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.errors import UserError
from iher_robot.learning.learner import Learner
from iher_robot.storage.episode_reader import EpisodeReader
from iher_robot.storage.ledger import Ledger
from iher_robot.training import train as train_module
from iher_robot.training.display import TrainingDisplay
from iher_robot.training.loop import TrainingRun
from iher_robot.training.setup import open_training_setup
from iher_robot.training.train import resume, train
from tests.drivers.fake_robot import FakeRobot, fake_spec
from tests.small_runs import TINY_LEARNER

TINY = (*TINY_LEARNER, "evaluation.robot_episodes=1")
MINUTES = 0.0667  # a little more than 100 ticks


class RemoteRobot(FakeRobot):
    """Behind a link that goes down on demand, and stays down until it is opened anew.

    Attributes:
        outages: By hook and number of its call: the link is lost there, and what attempts to
            open it raise until it is back.
        refused: What the next attempts to open it raise.
    """

    exclusive = True

    def __init__(self, spec: RobotSpec) -> None:
        super().__init__(spec)
        self.outages: dict[tuple[str, int], list[DriverError]] = {}
        self.refused: list[DriverError] = []
        self._down = False
        self._counted: Counter[str] = Counter()

    def _called(self, hook: str) -> None:
        super()._called(hook)
        self._counted[hook] += 1
        outage = self.outages.get((hook, self._counted[hook]))
        if outage is not None:
            self._down, self.refused = True, list(outage)
        if hook == "open":
            if self.refused:
                raise self.refused.pop(0)
            self._down = False
        elif self._down and hook not in {"hold", "close"}:
            raise LinkLost("fake does not answer")


class Pauses(SimulatedClock):
    """Does not sleep, but says how long it would have.

    Attributes:
        slept_s: Each pause.
        meanwhile: Called in each pause.
    """

    def __init__(self) -> None:
        super().__init__()
        self.slept_s: list[float] = []
        self.meanwhile: Callable[[], None] = lambda: None

    def sleep_until_ns(self, deadline_ns: int) -> None:
        self.slept_s.append((deadline_ns - self.now_ns()) / 1e9)
        self.meanwhile()
        super().sleep_until_ns(deadline_ns)


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> RemoteRobot:
    made = RemoteRobot(dataclasses.replace(fake_spec(), physical=False))
    monkeypatch.setattr(goal_env_module, "make_driver", lambda name, **_: made)
    torch.set_num_threads(1)
    return made


@pytest.fixture
def pauses(monkeypatch: pytest.MonkeyPatch) -> Pauses:
    clock = Pauses()
    module = train_module
    monkeypatch.setattr(module, "TrainingRun", partial(TrainingRun, clock=clock))
    return clock


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    lines: list[str] = []
    monkeypatch.setattr(TrainingDisplay, "announce", lambda _, text: lines.append(text))
    return lines


@pytest.fixture
def seeds(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Seeds of all resets that were tried."""
    tried: list[int] = []
    original = GoalRobotEnv.reset

    def noted(self: GoalRobotEnv, *, seed: int) -> Any:
        tried.append(seed)
        return original(self, seed=seed)

    monkeypatch.setattr(GoalRobotEnv, "reset", noted)
    return tried


def run(out: Path, *overrides: str) -> None:
    train(
        task="reach",
        driver="fake",
        preset="paper",
        budget_minutes=MINUTES,
        overrides=(*TINY, *overrides),
        out=out,
        until_success=None,
        device="cpu",
        display=False,
    )


def spent(out: Path, account: Any = "motion") -> int:
    with Ledger(out / "ledger.sqlite") as ledger:
        return ledger.spent_ticks(account)


def stored(out: Path, account: str = "motion") -> list[int]:
    episodes = EpisodeReader(out / "episodes")
    return [len(kept.episode) for kept in episodes if kept.account == account]


def lost(attempts: int) -> list[DriverError]:
    return [LinkLost("nobody answers") for _ in range(attempts)]


def test_a_lost_robot_costs_the_tick_in_flight_and_the_run_goes_on_when_it_is_back(
    tmp_path: Path, robot: RemoteRobot, pauses: Pauses, told: list[str], seeds: list[int]
) -> None:
    robot.outages = {("advance", 21): lost(5)}
    run(tmp_path / "run")
    assert stored(tmp_path / "run") == [20, 50, 29]
    assert spent(tmp_path / "run") == 100
    assert pauses.slept_s == [0.5, 1.0, 2.0, 4.0, 5.0]
    assert len(set(seeds[1:7])) == 1, "the same start is tried again"
    assert seeds[0] != seeds[1] != seeds[7]
    lines = [line for line in told if "fake" in line]
    assert "aborted: fake does not answer (after 21 ticks)" in lines[0]
    assert ["trying again" in line for line in lines[1:6]] == [True] * 5
    assert lines[6] == "fake is back, going on"
    assert not any("\n" in line for line in lines)


def test_an_attempt_that_did_not_begin_is_charged_nothing(
    tmp_path: Path, robot: RemoteRobot, pauses: Pauses
) -> None:
    robot.refused = lost(3)
    run(tmp_path / "run")
    assert len(pauses.slept_s) == 3
    assert spent(tmp_path / "run") == 100
    with sqlite3.connect(tmp_path / "run" / "ledger.sqlite") as ledger:
        query = "SELECT ticks FROM entry WHERE kind = ? AND account != 'reset' ORDER BY id"
        settled = [ticks for (ticks,) in ledger.execute(query, ("settle",))]
        reserved = ledger.execute(query, ("reserve",)).fetchall()
    assert settled == [0, 0, 0, 50, 50, 50]  # the last one is evaluation
    assert len(reserved) == len(settled)


@pytest.mark.parametrize("hook", ["reset", "read"])
def test_a_robot_that_is_lost_in_a_reset_is_waited_for(
    tmp_path: Path, robot: RemoteRobot, pauses: Pauses, hook: str
) -> None:
    robot.outages = {(hook, 1): []}
    run(tmp_path / "run")
    assert pauses.slept_s == [0.5]
    assert stored(tmp_path / "run") == [50, 50]
    assert spent(tmp_path / "run") == 100


def test_when_patience_is_over_the_run_ends_with_one_sentence_and_can_be_resumed(
    tmp_path: Path, robot: RemoteRobot, pauses: Pauses
) -> None:
    out = tmp_path / "run"
    robot.outages = {("advance", 21): lost(1000)}
    with pytest.raises(UserError) as error:
        run(out, "patience_minutes=2")
    sentence = str(error.value)
    assert sentence.startswith("fake is lost (nobody answers), and 2 minutes of waiting")
    assert sentence.endswith(f"continue with: iher-robot train --resume {out}")
    assert sum(pauses.slept_s) == pytest.approx(120.0)
    assert not robot.is_open
    assert (stored(out), spent(out)) == ([20], 21)
    robot.refused = []
    resume(out, display=False)
    assert (stored(out), spent(out)) == ([20, 50, 29], 100)


def test_without_patience_nothing_is_waited_for(
    tmp_path: Path, robot: RemoteRobot, pauses: Pauses
) -> None:
    robot.refused = lost(1)
    with pytest.raises(UserError, match="nobody answers"):
        run(tmp_path / "run", "patience_minutes=0")
    assert pauses.slept_s == []


def test_patience_is_whole_again_after_each_return(
    tmp_path: Path, robot: RemoteRobot, pauses: Pauses
) -> None:
    robot.outages = {("advance", 21): lost(4), ("advance", 60): lost(4)}
    run(tmp_path / "run", "patience_minutes=0.2")  # 12 s, of which each takes 7.5 s
    assert pauses.slept_s == 2 * [0.5, 1.0, 2.0, 4.0]
    assert stored(tmp_path / "run") == [20, 38, 40]
    assert spent(tmp_path / "run") == 100


def test_a_robot_that_somebody_else_has_is_waited_for(
    tmp_path: Path, robot: RemoteRobot, pauses: Pauses, told: list[str]
) -> None:
    robot.refused = [LeaseRefused("session 7 holds the lease")] * 2
    run(tmp_path / "run")
    assert len(pauses.slept_s) == 2
    assert sum("leased by another client" in line and "session 7" in line for line in told) == 2
    assert spent(tmp_path / "run") == 100


def test_a_stopped_robot_is_waited_for_until_an_operator_clears_it(
    tmp_path: Path,
    robot: RemoteRobot,
    pauses: Pauses,
    told: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def clear_in_the_third_pause() -> None:
        assert not robot.is_open
        if len(pauses.slept_s) == 3:
            robot.clear_fault("light curtain")

    pauses.meanwhile = clear_in_the_third_pause
    original, ticks = robot._advance, 0

    def stop_once() -> None:
        nonlocal ticks
        ticks += 1
        original()
        if ticks == 31:
            robot.stop("somebody came near", fault="light curtain")

    monkeypatch.setattr(robot, "_advance", stop_once)
    run(tmp_path / "run")
    assert len(pauses.slept_s) == 3
    assert sum("iher-robot clear-fault 'light curtain'" in line for line in told) == 3
    assert stored(tmp_path / "run") == [30, 50, 19]
    assert spent(tmp_path / "run") == 100


def test_waiting_can_be_interrupted_and_leaves_the_robot_disconnected(
    tmp_path: Path, robot: RemoteRobot, pauses: Pauses
) -> None:
    def interrupt() -> None:
        assert not robot.is_open
        raise KeyboardInterrupt

    pauses.meanwhile = interrupt
    robot.outages = {("advance", 21): lost(5)}
    with pytest.raises(KeyboardInterrupt) as error:
        run(tmp_path / "run")
    assert any("train --resume" in note for note in error.value.__notes__)
    assert (stored(tmp_path / "run"), spent(tmp_path / "run")) == ([20], 21)
    assert not robot.is_open
    assert len(pauses.slept_s) == 1


def test_a_robot_that_fails_otherwise_ends_the_run_at_once(
    tmp_path: Path, robot: RemoteRobot, pauses: Pauses
) -> None:
    robot.refused = [DriverError("no such scene")]
    with pytest.raises(DriverError, match="no such scene"):
        run(tmp_path / "run")
    assert pauses.slept_s == []
    assert spent(tmp_path / "run") == 0


def test_a_link_that_is_too_slow_is_told_and_charged_and_the_run_goes_on(
    tmp_path: Path, robot: RemoteRobot, told: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    original, ticks = robot._advance, 0

    def slow_at_first() -> None:
        nonlocal ticks
        ticks += 1
        robot.lost_ticks = 2 * (10 < ticks <= 16)
        original()

    monkeypatch.setattr(robot, "_advance", slow_at_first)
    run(tmp_path / "run")
    # Ten valid ticks and six of three robot ticks each; the last step has no end to be kept.
    assert stored(tmp_path / "run") == [15, 50, 22]
    assert spent(tmp_path / "run") == 10 + 6 * 3 + 50 + 22 == 100
    assert sum("iher-robot doctor" in line for line in told) == 1


def test_evaluation_runs_on_a_robot_that_no_second_driver_may_move(
    tmp_path: Path, robot: RemoteRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = Learner.learn
    armed: list[bool] = []

    def observed(self: Learner, *args: Any) -> Any:
        armed.append(robot.is_armed)
        return original(self, *args)

    monkeypatch.setattr(Learner, "learn", observed)
    run(tmp_path / "run", "evaluation.robot_episodes=3", "evaluation.episodes=7")
    assert stored(tmp_path / "run", "evaluation") == [50, 50, 50]
    assert spent(tmp_path / "run", "evaluation") == 150
    assert spent(tmp_path / "run") == 100
    assert robot.calls.count("advance") == 250
    assert armed == [False]
    assert not robot.is_armed


def test_a_robot_that_is_lost_in_an_evaluation_is_waited_for(
    tmp_path: Path, robot: RemoteRobot, pauses: Pauses
) -> None:
    robot.outages = {("advance", 111): lost(2)}
    run(tmp_path / "run", "evaluation.robot_episodes=2")
    assert len(pauses.slept_s) == 2
    assert stored(tmp_path / "run", "evaluation") == [10, 50]
    assert spent(tmp_path / "run", "evaluation") == 11 + 50
    assert spent(tmp_path / "run") == 100
    (row,) = map(json.loads, (tmp_path / "run" / "metrics.jsonl").read_text().splitlines())
    assert 0.0 <= row["success"] <= 0.5, "the episode that was aborted did not succeed"


def test_the_meaning_of_the_budget_says_how_long_the_robot_moves(
    robot: RemoteRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    overrides = ["budget_minutes=2", "evaluation.robot_episodes=4"]
    config = load_config("reach", preset="paper", overrides=overrides, driver="fake", device="cpu")
    with open_training_setup(config) as setup:
        assert setup.simulator is None
        simulated = setup.describe_budget(setup.budget, setup.budget.with_ticks(0))
        monkeypatch.setattr(RemoteRobot, "paces_itself", True)
        meaning = setup.describe_budget(setup.budget, setup.budget.with_ticks(0))
        later = setup.describe_budget(
            setup.budget.with_ticks(setup.budget.ticks + 1000), setup.budget.with_ticks(3000)
        )
    # 3,000 ticks are 60 episodes, in epochs of two; each of 30 evaluations has 200 ticks.
    assert "60 episodes of up to 50" in meaning
    assert "on the robot, on an account of its own, 4 episodes each time, about 120 in" in meaning
    assert "about 0:02:00 for the budget and 0:04:00 for evaluation" in meaning
    assert "real time" not in simulated
    assert meaning.startswith(simulated)
    assert later.startswith("0.6667 robot minutes of 2.667 are left, which are 1,000 ticks")
