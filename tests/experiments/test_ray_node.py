"""A cell on a node of a Ray cluster, without a cluster."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from iher_robot.experiments import ray as ray_module
from iher_robot.experiments.cell_process import CellJob, Outcome
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.experiments.ray import SharedFolder, run_on_node
from tests.run_folders import make_run

NAME = "reach-iher-default-seed0"
SMALL = ("config.yaml", "provenance.json", "metrics.jsonl", "policy.pt", "success.png")


@pytest.fixture
def jobs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[CellJob]:
    """Jobs that were run; each finishes at once."""
    found: list[CellJob] = []

    def finish(job: CellJob, *_: Callable[..., object]) -> Outcome:
        found.append(job)
        make_run(job.run)
        for name in (*SMALL[2:], "result.json"):
            (job.run / name).write_text(name)
        job.log.parent.mkdir(parents=True, exist_ok=True)
        job.log.write_text("== log\n")
        return Outcome(job.name, "finished")

    monkeypatch.setattr(ray_module, "run_cell", finish)
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path / "scratch"))
    return found


def job_in(folder: ExperimentFolder) -> CellJob:
    paths = folder.config(NAME), folder.run(NAME).path, folder.log(NAME)
    return CellJob(NAME, "task: reach\n", *paths).absolute()


def shared(folder: ExperimentFolder, content: bytes, *, ship: bool = False) -> SharedFolder:
    folder.path.mkdir()
    lock = folder.path / "experiment.lock"
    lock.write_bytes(b"this experiment")
    return SharedFolder(lock, hashlib.sha256(content).hexdigest(), ship)


def test_a_cell_runs_in_a_visible_folder(tmp_path: Path, jobs: list[CellJob]) -> None:
    folder = ExperimentFolder(tmp_path / "out")
    job = job_in(folder)

    outcome = run_on_node(job, shared(folder, b"this experiment"))

    assert jobs == [job]
    assert (outcome.ending, outcome.files) == ("finished", {})
    assert outcome.node


@pytest.mark.parametrize(("content", "ship"), [(b"another", False), (b"this experiment", True)])
def test_a_cell_on_the_nodes_own_disk_returns_small_files(
    tmp_path: Path, jobs: list[CellJob], content: bytes, ship: bool
) -> None:
    folder = ExperimentFolder(tmp_path / "out")
    job = job_in(folder)

    outcome = run_on_node(job, shared(folder, content, ship=ship))

    (local,) = jobs
    assert local.config == job.config
    for path in (local.config_path, local.run, local.log):
        assert path.is_relative_to(tmp_path / "scratch")
    assert local.config_path.parts[-2:] == ("configs", f"{NAME}.yaml")
    assert outcome.files.keys() == {*SMALL, "result.json", "log"}
    assert outcome.files["log"] == b"== log\n"
    assert not local.run.exists(), "its disk is freed"
