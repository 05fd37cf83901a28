"""Cells on a served robot: one at a time."""

from __future__ import annotations

from pathlib import Path

import pytest

from iher_robot.experiments import experiment as experiment_module
from iher_robot.experiments.experiment import experiment
from tests.experiments.small import TINY_SETTINGS, write_manifest
from tests.served.served_robot import PATIENT, ServedRobot

pytestmark = pytest.mark.real_time

CELLS = ("reach-iher-default-seed0", "reach-iher-default-seed1")


def test_cells_use_a_served_robot_one_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(experiment_module, "report", lambda folder: "none")
    out = tmp_path / "out"
    settings = dict(TINY_SETTINGS) | {
        "evaluation.robot_episodes": 1,
        "learner.schedule.updates_per_step": 1.0,
        "patience_minutes": 0.0,
    }
    with ServedRobot(tmp_path / "memory", *PATIENT) as served:
        grid = {
            "algos": ["iher"],
            "presets": ["default"],
            "driver": "zenoh",
            "robot": None,
            "connect": [served.endpoint],
            "budgets": [0.0333],  # an episode
            "seeds": [0, 1],
            "settings": settings,
        }
        manifest = write_manifest(tmp_path / "m.yaml", grid)
        with served.driver("reach"):  # which holds the lease
            refused = experiment(manifest, out=out, only=[CELLS[0]])
        (cell,) = refused.failed
        assert any("is used by" in line for line in cell.lines), cell.lines

        assert "one at a time, since they share a robot" in capsys.readouterr().out
        done = experiment(manifest, out=out, workers=2)

    assert not done.failed, done.summary()
    printed = capsys.readouterr().out.splitlines()
    shown = [line.replace(":", " ").split()[:2] for line in printed if line.startswith("reach-")]
    assert shown == [[cell, state] for cell in CELLS for state in ("running", "finished")]
