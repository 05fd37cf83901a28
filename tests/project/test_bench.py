"""The measurements of speed: what they count, how they judge, and that they run."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from bench.speed import products
from bench.speed.comparison import Comparison, Contender, Kind, Target
from bench.speed.precision import PRECISIONS
from bench.speed.results import rows
from bench.speed.rounds import Found, run_rounds
from bench.speed.settings import Settings
from iher_robot.config.options import load_config
from iher_robot.env.goal_env import make_env
from iher_robot.learning.learner import Learner
from iher_robot.learning.transitions import Transitions
from iher_robot.training.setup import make_learner
from tests.repository import ROOT

HIDDEN = (16, 8)
BATCH = 32


@pytest.fixture(scope="module")
def learner() -> Learner:
    overrides = ["learner.ddpg.hidden=[16,8]", "learner.dynamics.hidden=[12,6]"]
    config = load_config("reach", preset="paper", overrides=overrides)
    return make_learner(config, make_env("reach").task, torch.device("cpu"))


def test_the_products_of_an_update_are_those_that_torch_counts(learner: Learner) -> None:
    shapes = learner.shapes
    batch = Transitions(
        observation=torch.randn(BATCH, shapes.obs_dim),
        action=torch.randn(BATCH, shapes.action_dim),
        next_observation=torch.randn(BATCH, shapes.obs_dim),
        goal=torch.randn(BATCH, shapes.goal_dim),
        extrinsic=-torch.ones(BATCH),
        intrinsic=torch.zeros(BATCH),
        source=torch.zeros(BATCH),
    )
    with FlopCounterMode(display=False) as counter:
        learner.ddpg.update(batch)
    counted = products.update(BATCH, learner.policy.input_dim, shapes.action_dim, HIDDEN)
    assert counted == counter.get_total_flops()


def settings(rounds: int) -> Settings:
    return Settings(rounds, 1, torch.device("cpu"), (PRECISIONS["fp32"],), quick=False)


def compare(kind: Kind, ours: float, theirs: float, target: Target) -> Comparison:
    contenders = (Contender("ours", lambda _: ours), Contender("theirs", lambda _: theirs))
    return Comparison("topic", "work", "unit", kind, contenders, target=target)


def test_contenders_take_turns() -> None:
    measured: list[tuple[str, int]] = []

    def contender(name: str) -> Contender:
        def measure(number: int) -> float:
            measured.append((name, number))
            return 1.0

        return Contender(name, measure)

    contenders = (contender("a"), contender("b"), Contender("c", None, "not installed"))
    comparison = Comparison("topic", "work", "unit", Kind.RATE, contenders)
    few = replace(comparison, contenders=(contender("few"),), at_most_rounds=1)
    found = run_rounds([comparison, few], settings(rounds=3), lambda _: None)
    turns = ["a0", "b0", "few0", "b1", "a1", "a2", "b2"]
    assert [f"{name}{number}" for name, number in measured] == turns
    assert [len(figures) for figures in found[0].figures] == [3, 3, 0]


@pytest.mark.parametrize(
    ("kind", "ours", "better"),
    [(Kind.RATE, 3.0, 1.5), (Kind.SECONDS, 3.0, 2 / 3), (Kind.AMOUNT, 3.0, 2 / 3)],
)
def test_a_ratio_says_how_many_times_better_ours_is(kind: Kind, ours: float, better: float) -> None:
    for ratio, met in ((better - 0.01, True), (better + 0.01, False)):
        comparison = compare(kind, ours, 2.0, Target("", rival="theirs", ratio=ratio))
        (found,) = run_rounds([comparison], settings(rounds=2), lambda _: None)
        mine, theirs = rows(found, with_targets=True)
        assert theirs["ours_is"] == pytest.approx(better)
        assert mine["target_met"] is met


def test_targets_of_time_and_of_products_are_judged_by_the_median() -> None:
    work = products.Products(operations=1e9, rows=8, width=8)
    for target, met in (
        (Target("", seconds=2.0), True),
        (Target("", seconds=1.9), False),
        (Target("", times_products=2.1), True),  # 2 s, where the products take 1 s
        (Target("", times_products=1.9), False),
    ):
        comparison = replace(compare(Kind.SECONDS, 2.0, 2.0, target), products=work)
        found = Found(comparison)
        found.figures = [[2.0, 9.0, 1.0], []]
        found.products = [1e9] * 3
        mine, absent = rows(found, with_targets=True)
        assert mine["target_met"] is met
        assert mine["times_products"] == pytest.approx(2.0)
        assert absent["median"] is None


def test_a_quick_run_prints_its_table_and_keeps_what_it_says(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3", reason="comes with the bench extra")
    out = tmp_path / "speed.json"
    command = [sys.executable, "-m", "bench.speed", "--quick", "--rounds", "2"]
    command += ["--only", "dynamics", "simulation", "--precision", "fp32", "--out", str(out)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    document = json.loads(out.read_text())
    assert document["rounds"] == 2
    assert {"cpu", "gpu", "cpu_flags"} <= set(document["machine"])
    assert {"torch", "stable_baselines3", "sbx-rl"} <= set(document["versions"])
    figures = document["figures"]
    assert {row["topic"] for row in figures} == {"dynamics", "simulation"}
    for row in figures:
        assert row["who"] in done.stdout
        if row["median"] is None:
            assert row["note"], row
            continue
        assert len(row["all"]) == 2
        assert 0.0 < row["min"] <= row["median"] <= row["max"]
        assert (row["times_products"] is not None) == (row["topic"] == "dynamics")
