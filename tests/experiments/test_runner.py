"""Outcomes of cells, without training."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from iher_robot.cli.app import app
from iher_robot.errors import UserError
from iher_robot.experiments import experiment as experiment_module
from iher_robot.experiments.cell_process import Outcome
from iher_robot.experiments.executor import LocalExecutor
from iher_robot.experiments.experiment import experiment
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.experiments.progress import ProgressTable
from iher_robot.experiments.report.rows import provenance_columns
from iher_robot.experiments.runner import CellRunner
from iher_robot.storage.provenance import write_provenance
from iher_robot.storage.run_directory import RunDirectory
from tests.experiments.made import NAMES, begin, make_cells, make_experiment


@pytest.fixture
def ending(monkeypatch: pytest.MonkeyPatch) -> dict[str, Outcome]:
    """Outcomes of cells by name; others finish."""
    found: dict[str, Outcome] = {}
    monkeypatch.setattr(
        LocalExecutor,
        "_run",
        lambda self, job: found.get(job.name, Outcome(job.name, "finished")),
    )
    return found


def test_the_reason_of_a_failure_is_kept_until_the_cell_runs_again(
    tmp_path: Path, ending: dict[str, Outcome]
) -> None:
    folder = ExperimentFolder(tmp_path / "out")
    cells = begin(folder)
    ending[NAMES[1]] = Outcome(NAMES[1], "failed", "exit code 2", ("one", "iher-robot: no disk"))
    ending[NAMES[2]] = Outcome(NAMES[2], "interrupted", "interrupted")

    def run() -> None:
        with LocalExecutor(2) as executor:
            runner = CellRunner(folder, executor, ProgressTable("", enabled=False))
            runner.prepare(cells)
            runner.submit(cells)
            while runner.busy:
                runner.wait()

    run()
    assert [folder.failure(name).exists() for name in NAMES] == [False, True, False]
    assert folder.failure(NAMES[1]).read_text() == "exit code 2: iher-robot: no disk\n"
    ending.clear()
    run()
    assert not folder.failure(NAMES[1]).exists()


def test_the_table_of_runs_has_the_provenance_of_all_processes(tmp_path: Path) -> None:
    run = RunDirectory(tmp_path)
    assert provenance_columns(run) == {}
    first = {
        "command": [
            "/bin/iher-robot",
            "train",
            "--set",
            "hidden=[32, 32]",
            "--preset",
            "my a.yaml",
        ],
        "commit": "1" * 40,
        "dirty": False,
        "machine": {"cpu": "one", "cores": 2, "system": "Linux"},
        "versions": {"python": "3.11", "torch": "2.1", "gymnasium-robotics": "1"},
    }
    machine = {"cpu": "other", "cores": 2, "system": "Linux"}
    versions = {"python": "3.11", "torch": "2.2", "iher-robot": "7"}
    second = {"commit": "2" * 40, "dirty": True, "machine": machine, "versions": versions}
    for process in (first, second, first):
        write_provenance(run.provenance_path, dict(process))

    assert provenance_columns(run) == {
        "command": "iher-robot train --set 'hidden=[32, 32]' --preset 'my a.yaml'",
        "processes": 3,
        "commit": f"{'1' * 40}, {'2' * 40}",
        "dirty": True,
        "cpu": "one, other",
        "cores": "2",
        "system": "Linux",
        "python": "3.11",
        "iher_robot": "7",
        "torch": "2.1, 2.2",
        "mujoco": None,
        "gymnasium_robotics": "1",
        "numpy": None,
    }


def test_runs_that_are_not_selected_are_checked_too(
    tmp_path: Path, ending: dict[str, Outcome]
) -> None:
    folder = make_experiment(tmp_path / "out")
    make_cells(tmp_path, settings={"learner.ddpg.gamma": 0.5})
    manifest = str(tmp_path / "m.yaml")

    with pytest.raises(UserError, match=r"seed0 was run with .*learner\.ddpg\.gamma"):
        experiment(manifest, out=folder.path, only=["*-seed2"], display=False)
    assert not ending


def test_a_missing_report_is_printed_and_fails(
    tmp_path: Path, ending: dict[str, Outcome], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(folder: Path) -> None:
        raise UserError("another process writes tables")

    make_cells(tmp_path)
    monkeypatch.setattr(experiment_module, "report", refuse)
    arguments = ["experiment", str(tmp_path / "m.yaml"), "--out", str(tmp_path / "out"), "--quiet"]

    result = CliRunner().invoke(app, arguments)

    assert "3 of 3 cells finished" in result.output
    assert "no report: another process writes tables" in result.output
    assert result.exit_code == 1
    assert not ending
