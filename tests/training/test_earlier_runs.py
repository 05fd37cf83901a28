"""Run folders of earlier versions resume, evaluate, export and start other runs."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from iher_robot.config.robot import choose_robot
from iher_robot.datasets.api import export_parquet, verify
from iher_robot.evaluation.compatibility import check_fit, load_trained_policy
from iher_robot.evaluation.evaluate import evaluate
from iher_robot.training.train import resume, train
from tests.repository import ROOT
from tests.small_runs import metrics

FOLDERS = sorted(path for path in (ROOT / "tests" / "earlier_runs").iterdir() if path.is_dir())


TINY = (
    "evaluation.episodes=1",
    "evaluation.final_episodes=0",
    "learner.ddpg.hidden=[8, 8]",
    "learner.schedule.updates_per_step=1",
)


@pytest.fixture(params=FOLDERS, ids=lambda path: path.name)
def earlier(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A copy of a stopped run: two epochs of Reach of a budget of three."""
    return Path(shutil.copytree(request.param, tmp_path / "run"))


def test_a_run_of_an_earlier_version_resumes_to_its_budget(earlier: Path) -> None:
    before = metrics(earlier)
    result = resume(earlier, display=False)
    assert metrics(earlier)[: len(before)] == before
    assert result.epochs == len(before) + 1 == 3
    assert result.robot_minutes == result.budget_minutes == pytest.approx(0.1)
    assert metrics(earlier)[-1]["updates"] == 3 * 50
    assert verify([earlier]).problems == ()


def test_the_policy_of_an_earlier_version_acts_and_fits_its_robot(earlier: Path) -> None:
    policy = load_trained_policy(earlier / "policy.pt")
    with choose_robot("mujoco", "fetch-mocap").make_env("reach") as env:
        assert check_fit(policy, env) == ()
    assert evaluate(earlier / "policy.pt", episodes=2, robot="fetch-mocap").episodes == 2


def test_the_data_of_an_earlier_version_are_whole_and_export(earlier: Path) -> None:
    assert verify([earlier]).problems == ()
    exported = export_parquet([earlier], out=earlier.parent / "run.parquet")
    assert (exported.episodes, exported.ticks) == (2, 100)


def test_the_data_of_an_earlier_version_start_another_run(earlier: Path) -> None:
    result = train(
        task="reach",
        robot="fetch-mocap",
        budget_minutes=0.04,
        from_data=[earlier],
        overrides=TINY,
        out=earlier.parent / "next",
        display=False,
    )
    assert result.epochs >= 2, "an epoch of earlier data, and one of its own"
