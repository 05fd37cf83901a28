"""A cell is run again from what a report keeps."""

from __future__ import annotations

import csv
import shlex
import shutil
import signal
from pathlib import Path

import pytest

from iher_robot.cli.app import main
from iher_robot.config.run import read_config
from iher_robot.experiments.experiment import experiment
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.experiments.report.report import ReportResult, report
from tests.experiments.made import NAMES, commit, make_experiment
from tests.experiments.small import epochs, process_count, start, write_manifest
from tests.served.served_robot import eventually
from tests.small_runs import metrics

pytest.importorskip("pandas")

CELLS = ("reach-her-matched-paper-seed0", "reach-her-matched-paper-seed1")


def test_a_cell_is_reproduced_from_a_committed_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, kept = tmp_path / "out", tmp_path / "kept"
    manifest = write_manifest(tmp_path / "m.yaml", {"budgets": [0.2], "seeds": [0, 1]})
    running = start(manifest, out, "--quiet", "--workers", "1")
    try:
        assert eventually(lambda: len(epochs(out, CELLS[0])) >= 1, 60.0)
        running.send_signal(signal.SIGINT)
        running.communicate(timeout=30.0)
    finally:
        running.kill()
    done = experiment(manifest, out=out, workers=2, display=False)
    assert done.complete, done.summary()
    assert isinstance(done.report, ReportResult)
    assert [process_count(out, cell) for cell in CELLS] == [2, 1]
    runs = {cell: metrics(out / "cells" / cell) for cell in CELLS}

    report(out, out=kept)
    shutil.rmtree(out)
    (tmp_path / "m.yaml").unlink()

    with (kept / "runs.csv").open(newline="") as file:
        commands = {row["cell"]: shlex.split(row["command"]) for row in csv.DictReader(file)}
    assert commands[CELLS[0]][:3] == ["iher-robot", "train", "--config"]
    assert Path(commands[CELLS[0]][3]).parts[-2:] == ("configs", f"{CELLS[0]}.yaml")
    monkeypatch.chdir(kept)
    for cell in CELLS:
        with pytest.raises(SystemExit) as stopped:
            main(["train", "--config", f"configs/{cell}.yaml", "--out", f"../{cell}", "--quiet"])
        assert stopped.value.code == 0
        assert metrics(tmp_path / cell) == runs[cell]


def test_a_report_keeps_the_settings_of_every_run(tmp_path: Path) -> None:
    folder = make_experiment(tmp_path / "out")
    kept = ExperimentFolder(tmp_path / "kept")

    report(folder.path, out=kept.path)

    assert sorted(path.stem for path in kept.configs_path.iterdir()) == [*NAMES[:2]]
    for name in NAMES[:2]:
        assert read_config(kept.config(name)) == read_config(folder.run(name).config_path)
    assert not folder.configs_path.exists(), "nothing is changed there"
    again = ExperimentFolder(tmp_path / "again")
    report(kept.path, out=again.path)
    for name in NAMES[:2]:
        assert again.config(name).read_bytes() == kept.config(name).read_bytes()


def test_damaged_settings_do_not_replace_kept_ones(tmp_path: Path) -> None:
    folder = make_experiment(tmp_path / "out")
    report(folder.path)
    before = folder.config(NAMES[0]).read_bytes()
    config = folder.run(NAMES[0]).config_path
    config.write_bytes(before[: len(before) // 2])

    report(folder.path)

    assert folder.config(NAMES[0]).read_bytes() == before
    assert commit(folder).configs_path.exists() is False, "the tables are enough for a report"
