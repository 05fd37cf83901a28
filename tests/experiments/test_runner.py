"""What is kept of how cells ended, without training."""

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
from iher_robot.experiments.progress import Board
from iher_robot.experiments.report.rows import origin_of
from iher_robot.experiments.runner import Running
from iher_robot.storage.provenance import write_provenance
from iher_robot.storage.run_directory import RunDirectory
from tests.experiments.made import NAMES, begin, make_cells, make_experiment


@pytest.fixture
def ending(monkeypatch: pytest.MonkeyPatch) -> dict[str, Outcome]:
    """How cells end, by name; others finish."""
    found: dict[str, Outcome] = {}
    monkeypatch.setattr(
        LocalExecutor,
        "_run",
        lambda self, order: found.get(order.name, Outcome(order.name, "finished")),
    )
    return found


def test_why_a_cell_failed_is_kept_until_it_runs_again(
    tmp_path: Path, ending: dict[str, Outcome]
) -> None:
    folder = ExperimentFolder(tmp_path / "out")
    cells = begin(folder)
    ending[NAMES[1]] = Outcome(NAMES[1], "failed", "exit code 2", ("one", "iher-robot: no disk"))
    ending[NAMES[2]] = Outcome(NAMES[2], "interrupted", "interrupted")

    def run() -> None:
        with LocalExecutor(2) as executor:
            running = Running(folder, executor, Board("", enabled=False))
            running.prepare(cells)
            running.submit(cells)
            while running.busy:
                running.wait()

    run()
    assert [folder.failure(name).exists() for name in NAMES] == [False, True, False]
    assert folder.failure(NAMES[1]).read_text() == "exit code 2: iher-robot: no disk\n"
    ending.clear()
    run()
    assert not folder.failure(NAMES[1]).exists()


def test_a_run_tells_of_all_of_its_processes(tmp_path: Path) -> None:
    run = RunDirectory(tmp_path)
    assert origin_of(run) == {}
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

    assert origin_of(run) == {
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


def test_runs_that_are_not_chosen_must_be_those_of_the_manifest(
    tmp_path: Path, ending: dict[str, Outcome]
) -> None:
    folder = make_experiment(tmp_path / "out")
    make_cells(tmp_path, settings={"learner.ddpg.gamma": 0.5})
    manifest = str(tmp_path / "m.yaml")

    with pytest.raises(UserError, match=r"seed0 was run with .*learner\.ddpg\.gamma"):
        experiment(manifest, out=folder.path, only=["*-seed2"], display=False)
    assert not ending


def test_an_experiment_without_a_report_says_so(
    tmp_path: Path, ending: dict[str, Outcome], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(folder: Path) -> None:
        raise UserError("another process writes tables")

    make_cells(tmp_path)
    monkeypatch.setattr(experiment_module, "report", refuse)
    words = ["experiment", str(tmp_path / "m.yaml"), "--out", str(tmp_path / "out"), "--quiet"]

    result = CliRunner().invoke(app, words)

    assert "3 of 3 cells finished" in result.output
    assert "no report: another process writes tables" in result.output
    assert result.exit_code == 1
    assert not ending
