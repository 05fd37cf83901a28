"""Searches for settings."""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from iher_robot.errors import UserError
from iher_robot.experiments.cell_process import CellJob, Outcome
from iher_robot.experiments.executor import LocalExecutor
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.experiments.grid import Cell, expand
from iher_robot.experiments.manifest import read_manifest
from iher_robot.experiments.progress import ProgressTable
from iher_robot.experiments.runner import CellRunner
from tests.experiments.small import write_manifest
from tests.run_folders import make_run

pytest.importorskip("optuna")
pytest.importorskip("pandas")

from iher_robot.experiments.search import SearchRun

SEARCH: dict[str, Any] = {
    "parameters": {
        "learner.ddpg.gamma": {"low": 0.5, "high": 0.99},
        "learner.ddpg.batch_size": {"choices": [64, 128]},
    },
    "objective": "minutes-to-success",
    "success": 0.9,
    "trials": 12,
    "seed": 3,
}
GRID = {"presets": ["default"], "algos": ["iher"], "budgets": [2.0], "settings": {}}


@pytest.fixture(autouse=True)
def with_any_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Skip the check of settings: the runs that replace training have others."""

    def state(folder: ExperimentFolder, cell: Cell) -> str:
        return "finished" if folder.run(cell.name).path.exists() else "new"

    monkeypatch.setattr("iher_robot.experiments.runner.prepare_cell", state)


class Instant(LocalExecutor):
    """Replaces training: the value of a cell is a function of its settings."""

    def __init__(self, folder: ExperimentFolder) -> None:
        super().__init__(1)
        self.folder = folder

    def _run(self, job: CellJob) -> Outcome:
        gamma = float(yaml.safe_load(job.config)["learner"]["ddpg"]["gamma"])
        run = self.folder.run(job.name)
        make_run(run.path, budget_minutes=2.0)
        run.append_metrics({"epoch": 1, "robot_minutes": 0.5, "success": 0.1})
        run.append_metrics(
            {"epoch": 2, "robot_minutes": 1.0 + (gamma - 0.8) ** 2, "success": 0.95}
            if gamma < 0.9
            else {"epoch": 2, "robot_minutes": 2.0, "success": 0.45}
        )
        return Outcome(job.name, "finished")


def search(
    folder: Path, grid: Mapping[str, Any] | None = None, **changed: Any
) -> list[dict[str, str]]:
    manifest = read_manifest(
        write_manifest(folder / "m.yaml", GRID | dict(grid or {}), search=SEARCH | changed)
    )
    out = ExperimentFolder(folder / "out")
    assert manifest.search is not None
    assert expand(manifest)
    with out.hold(), Instant(out) as executor:
        runner = CellRunner(out, executor, ProgressTable("", enabled=False))
        made = SearchRun(manifest, manifest.search, runner)
        out.begin(manifest, {"command": []}, made.identities)
        try:
            made.run()
        finally:
            assert {i.name for i in out.identities()} >= set(runner.outcomes)
    with out.trials_path.open() as file:
        return list(csv.DictReader(file))


def test_a_search_records_the_value_of_each_trial(tmp_path: Path) -> None:
    trials = search(tmp_path)

    assert [trial["state"] for trial in trials] == ["complete"] * 12
    for trial in trials:
        gamma, value = float(trial["learner.ddpg.gamma"]), float(trial["minutes-to-success"])
        # Not reached counts as a budget plus the share by which the last rate misses.
        assert value == pytest.approx(1.0 + (gamma - 0.8) ** 2 if gamma < 0.9 else 2.0 * 1.5)
        assert int(trial["learner.ddpg.batch_size"]) in (64, 128)
    assert len({trial["learner.ddpg.gamma"] for trial in trials}) == 12
    assert (tmp_path / "out" / "search.sqlite").exists()


def test_an_interrupted_search_continues_like_an_uninterrupted_one(tmp_path: Path) -> None:
    for name in ("whole", "cut"):
        (tmp_path / name).mkdir()
    whole = search(tmp_path / "whole")

    first = search(tmp_path / "cut", trials=5)
    assert search(tmp_path / "cut") == whole
    assert first == whole[:5]


def test_a_search_with_other_ranges_is_refused(tmp_path: Path) -> None:
    search(tmp_path, trials=1)
    other = {"learner.ddpg.gamma": {"low": 0.1, "high": 0.2}}

    with pytest.raises(UserError, match="its ranges or choices are not those of the manifest"):
        search(tmp_path, parameters=other)


@pytest.mark.parametrize(
    ("changed", "grid", "said"),
    [
        (
            {"objective": "success-at-budget"},
            {},
            "its objective is 'minutes-to-success', and 'success-at-budget' in the manifest",
        ),
        ({"success": 0.5}, {}, "its success is 0.9, and 0.5 in the manifest"),
        ({}, {"seeds": [0, 1]}, "its grid is not that of the manifest"),
        ({}, {"settings": {"evaluation.episodes": 7}}, "its grid is not that of the manifest"),
    ],
)
@pytest.mark.parametrize("trials", [1, 2])
def test_another_search_in_the_same_folder_is_refused(
    tmp_path: Path, changed: dict[str, Any], grid: dict[str, Any], said: str, trials: int
) -> None:
    before = search(tmp_path, trials=1)

    with pytest.raises(UserError) as caught:
        search(tmp_path, grid=grid, trials=trials, **changed)

    assert said in str(caught.value)
    assert search(tmp_path, trials=1) == before


@pytest.mark.parametrize(
    ("key", "parameter", "said"),
    [
        ("learner.ddpg.gama", {"low": 0.5, "high": 0.9}, "unknown key 'learner.ddpg.gama'"),
        ("learner.ddpg.gamma", {"low": 0.5, "high": 1.5}, "gamma is 1.5, allowed: "),
        ("learner.ddpg.gamma", {"low": -0.5, "high": 0.9}, "gamma is -0.5, allowed: "),
        ("learner.ddpg.critics", {"low": 1, "high": 2}, "critics is 1.0, allowed: an integer"),
        ("learner.ddpg.inputs", {"choices": ["absolute", "relativ"]}, "inputs is 'relativ'"),
        ("learner.ddpg.gamma", {"low": -math.inf, "high": 0.9}, "allowed: a finite number with"),
        ("budget_minutes", {"low": 1, "high": 9}, "use the grid's key budgets"),
    ],
)
def test_the_search_space_is_checked_before_there_is_a_study(
    tmp_path: Path, key: str, parameter: dict[str, Any], said: str
) -> None:
    parameters = {"learner.ddpg.batch_size": {"choices": [64]}, key: parameter}

    with pytest.raises(UserError) as caught:
        search(tmp_path, parameters=parameters)

    assert said in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_parameters_may_depend_on_each_other(tmp_path: Path) -> None:
    parameters = {  # the preset has fewer critics than the first of these subsets
        "learner.ddpg.critics": {"low": 20, "high": 30, "integer": True},
        "learner.ddpg.target_subset": {"low": 15, "high": 20, "integer": True},
        "learner.ddpg.gamma": SEARCH["parameters"]["learner.ddpg.gamma"],
    }
    assert len(search(tmp_path, parameters=parameters, trials=1)) == 1


def test_a_trial_with_a_failed_cell_is_run_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(self: Instant, job: CellJob) -> Outcome:
        return Outcome(job.name, "failed", "exit code 1")

    with monkeypatch.context() as patched:
        patched.setattr(Instant, "_run", fail)
        failed = search(tmp_path, trials=2)

    assert [(t["state"], t["minutes-to-success"]) for t in failed] == [("failed", "")] * 2

    again = search(tmp_path, trials=2)

    assert [trial["state"] for trial in again] == ["complete"] * 2
    settings = [[trial[key] for key in SEARCH["parameters"]] for trial in failed]
    assert [[trial[key] for key in SEARCH["parameters"]] for trial in again] == settings


def test_a_search_without_optuna(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(UserError, match="the extra 'sweep'"):
        search(tmp_path)
