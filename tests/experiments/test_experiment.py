"""Experiments with real processes: killed, interrupted, with failing cells."""

from __future__ import annotations

import signal
import threading
from pathlib import Path
from typing import Any

import pytest

from iher_robot.errors import UserError
from iher_robot.experiments import experiment as experiment_module
from iher_robot.experiments.cell_process import hold_cell
from iher_robot.experiments.experiment import experiment
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.storage.files.lock import FileHeld, LockFile
from iher_robot.storage.run_result import read_result
from tests.experiments.small import (
    EPOCH_MINUTES,
    TINY_SETTINGS,
    epochs,
    process_count,
    processes_of,
    start,
    write_manifest,
)
from tests.served.served_robot import eventually

LONG = {"budgets": [0.27], "seeds": [0, 1]}  # 4 epochs
CELLS = ("reach-her-matched-paper-seed0", "reach-her-matched-paper-seed1")


@pytest.fixture(autouse=True)
def without_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports are tested elsewhere."""
    monkeypatch.setattr(experiment_module, "report", lambda folder: "none")


def test_a_killed_experiment_continues(tmp_path: Path) -> None:
    out, manifest = tmp_path / "out", write_manifest(tmp_path / "m.yaml", LONG)
    first = start(manifest, out, "--quiet", "--workers", "2")
    try:
        begun = eventually(lambda: all(len(epochs(out, cell)) >= 1 for cell in CELLS), 60.0)
        assert begun, first.communicate()
        with pytest.raises(UserError, match=rf"another experiment runs in .*process {first.pid}"):
            experiment(manifest, out=out)
        assert len(processes_of(out)) == 2
    finally:
        first.kill()
        first.wait()

    assert eventually(lambda: processes_of(out) == [], 20.0), "they end by themselves"
    done = experiment(manifest, out=out, workers=2, display=False)

    assert not done.failed
    for cell in CELLS:
        log = (out / "logs" / f"{cell}.log").read_text()
        assert "interrupted; continue with" in log, "in order, as after a Ctrl-C"
        assert "--resume" in log
        assert epochs(out, cell) == [1, 2, 3, 4, 5][: len(epochs(out, cell))]
        assert process_count(out, cell) == 2
        result = read_result(out / "cells" / cell / "result.json")
        assert result is not None
        assert result.robot_minutes == pytest.approx(0.27)
        assert result.final_episodes == 2

    again = experiment(manifest, out=out, display=False)

    assert not again.failed
    assert [process_count(out, cell) for cell in CELLS] == [2, 2], "finished cells are kept"


def test_a_cell_waits_for_its_earlier_process(tmp_path: Path) -> None:
    path = tmp_path / "cell.lock"
    earlier = LockFile(path, "held")
    threading.Timer(0.3, earlier.close).start()

    with hold_cell(path, lambda: False):
        pass
    with LockFile(path, "held"):
        with pytest.raises(FileHeld, match="an earlier process of cell still runs"):
            hold_cell(path, lambda: False, patience_s=0.0)
        with pytest.raises(FileHeld):
            hold_cell(path, lambda: True)


def test_an_interrupt_ends_the_cells_and_prints_how_to_continue(tmp_path: Path) -> None:
    out = tmp_path / "out"
    manifest = write_manifest(tmp_path / "m.yaml", LONG | {"budgets": [100.0]})
    running = start(manifest, out, "--workers", "1")
    try:
        assert eventually(lambda: len(epochs(out, CELLS[0])) >= 1, 60.0)
        (cell,) = processes_of(out)
        environment = Path(f"/proc/{cell}/environ").read_bytes().decode().split("\0")
        running.send_signal(signal.SIGINT)
        printed, _ = running.communicate(timeout=30.0)
    finally:
        running.kill()

    assert running.returncode == 130, printed
    assert f"interrupted; continue with: iher-robot experiment {manifest} --out {out}" in printed
    assert processes_of(out) == []
    assert epochs(out, CELLS[1]) == []
    assert "OMP_NUM_THREADS=1" in environment


def test_cells_are_run_once_and_fail_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    # Less than a tick is refused by the run itself, once it has a robot.
    good, bad = (
        "reach-her-matched-paper-0.0667min-seed0",
        "reach-her-matched-paper-1e-05min-seed0",
    )
    manifest = write_manifest(tmp_path / "m.yaml", {"budgets": [1e-5, EPOCH_MINUTES]})
    # Leftovers of a run that ended before its settings were written.
    (out / "cells" / good).mkdir(parents=True)
    (out / "cells" / good / "config.yaml").touch()

    part = experiment(manifest, out=out, only=["*-0.0667min-*"])

    assert [(outcome.name, outcome.ending) for outcome in part.outcomes] == [(good, "finished")]
    assert {identity.name for identity in ExperimentFolder(out).identities()} == {good, bad}
    capsys.readouterr()

    done = experiment(manifest, out=out)

    (failed,) = done.failed
    log = out / "logs" / f"{bad}.log"
    assert (failed.name, failed.ending, failed.reason) == (bad, "failed", "exit code 2")
    printed = capsys.readouterr().out
    assert f"{bad} failed (exit code 2); {log} ends:\n    == " in printed
    assert "\n    iher-robot: " in printed
    assert "1 of 2 cells finished" in done.summary()
    assert f"see {log}" in done.summary()
    assert process_count(out, good) == 1

    changed = {"settings": dict(TINY_SETTINGS) | {"learner.ddpg.gamma": 0.5}}
    other = write_manifest(tmp_path / "n.yaml", changed | {"budgets": [1e-5, EPOCH_MINUTES]})
    with pytest.raises(UserError) as caught:
        experiment(other, out=out)
    assert "was run with learner.ddpg.gamma 0.98, where the manifest has 0.5" in str(caught.value)
    (out / "cells" / good / "config.yaml").write_text("")
    with pytest.raises(UserError, match="is no run of this experiment"):
        experiment(manifest, out=out)


def test_options_that_exclude_each_other(tmp_path: Path) -> None:
    manifest = write_manifest(tmp_path / "m.yaml", {})

    options: dict[str, Any]
    for options, said in (
        ({"workers": 0}, "--workers is 0"),
        ({"executor": "slurm"}, "unknown executor 'slurm', valid: local, ray"),
        ({"executor": "ray", "workers": 2}, "--workers is for --executor local"),
        ({"only": ["seed0"]}, "'seed0', which matches none of the 1 cells"),
        ({"address": "auto"}, "--address and --ship are for --executor ray"),
    ):
        with pytest.raises(UserError, match=said):
            experiment(manifest, out=tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()
