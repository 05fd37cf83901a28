"""Tables of an experiment: content, rows without runs, damage."""

from __future__ import annotations

import json
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from iher_robot.errors import UserError
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.experiments.report.report import report
from iher_robot.storage.files.checksum import add_checksum
from iher_robot.storage.files.lock import FileHeld, LockFile
from tests.experiments.made import NAMES, begin, commit, make_cell, make_experiment, unsealed

pytest.importorskip("pandas")

from iher_robot.experiments.report.tables import read_tables, write_tables


@pytest.fixture
def folder(tmp_path: Path) -> ExperimentFolder:
    return make_experiment(tmp_path / "out")


def runs_of(folder: ExperimentFolder) -> dict[str, dict[str, Any]]:
    write_tables(folder, folder)
    return {row["cell"]: row for row in read_tables(folder)[1].to_dict("records")}


def states_of(folder: ExperimentFolder) -> list[str]:
    return [row["state"] for row in runs_of(folder).values()]


def content(folder: ExperimentFolder) -> tuple[str, str]:
    return folder.runs_path.read_text(), folder.evaluations_path.read_text()


def test_a_row_of_a_run_has_its_state(folder: ExperimentFolder) -> None:
    folder.logs_path.mkdir()
    assert states_of(folder) == ["finished", "interrupted", "not begun"]
    with LockFile(folder.lock(NAMES[1]), "held"):
        assert states_of(folder) == ["finished", "running", "not begun"]
    folder.failure(NAMES[1]).write_text("exit code 1: out of memory\n")
    folder.failure(NAMES[2]).write_text("exit code 2: no such robot\n")

    rows = runs_of(folder)

    assert [row["state"] for row in rows.values()] == ["finished", "failed", "failed"]
    assert [row["reason"] for row in rows.values()] == [
        *("", "exit code 1: out of memory", "exit code 2: no such robot")
    ]
    assert [row["evaluations"] for row in rows.values()] == [2, 3, 0]


@pytest.mark.parametrize("cells", ["missing", "empty"])
def test_rows_of_runs_without_a_folder_stay(folder: ExperimentFolder, cells: str) -> None:
    small = commit(folder)
    before = content(small)
    if cells == "empty":
        small.cells_path.mkdir()

    report(small.path)

    assert content(small) == before
    # Another seed is added.
    begin(small, seeds=(0, 1, 2, 3))
    make_cell(small, "reach-iher-default-seed3", (0.5,), done=True)
    write_tables(small, small)
    assert states_of(small) == ["finished", "interrupted", "not begun", "finished"]
    assert len(read_tables(small)[0]) == 2 + 3 + 1


def test_tables_are_rewritten_where_all_runs_have_a_folder(folder: ExperimentFolder) -> None:
    write_tables(folder, folder)
    before = content(folder)
    folder.evaluations_path.write_text("cut off")

    write_tables(folder, folder)

    assert content(folder) == before


def test_holding_a_folder_creates_no_cells(folder: ExperimentFolder) -> None:
    small = commit(folder)
    with small.hold():
        pass
    assert not small.cells_path.exists()


def test_numbers_and_names_are_read_as_they_were_written(tmp_path: Path) -> None:
    folder = ExperimentFolder(tmp_path / "out")
    (cell,) = begin(folder, (0,), variants={"None": {}})
    rates = [k / n for n in (3, 7, 9, 49) for k in range(n + 1)]
    make_cell(folder, cell.name, rates, done=False)

    write_tables(folder, folder)

    table = read_tables(folder)[0]
    assert table["success"].tolist() == rates
    assert set(table["variant"]) == {"None"}


def test_a_report_elsewhere_changes_nothing_here(folder: ExperimentFolder, tmp_path: Path) -> None:
    folder.trials_path.write_text("trial,state,success-at-budget\n0,complete,0.5\n")
    before = {path.name for path in folder.path.iterdir()}
    elsewhere = tmp_path / "elsewhere"

    made = report(folder.path, out=elsewhere)

    assert {path.name for path in folder.path.iterdir()} == before
    assert made.table.parent == made.html.parent == elsewhere
    again = report(elsewhere)
    assert "0.5" in again.markdown.read_text()
    assert report(folder.path, out=elsewhere).table == made.table
    with pytest.raises(UserError, match="is the folder of another experiment"):
        report(elsewhere, out=folder.path)
    other = unsealed(folder.metadata_path) | {"processes": [{"command": ["x"]}]}
    (elsewhere / "experiment.json").write_text(json.dumps(add_checksum(other)))
    with pytest.raises(UserError, match="is the folder of another experiment"):
        report(folder.path, out=elsewhere)


def test_a_damaged_run_does_not_prevent_the_report_of_the_others(folder: ExperimentFolder) -> None:
    path = folder.run(NAMES[1]).metrics_path
    path.write_text(path.read_text().replace('"epoch": 2', '"epoch": 3'))

    made = report(folder.path)

    row = runs_of(folder)[NAMES[1]]
    assert (row["state"], row["evaluations"]) == ("damaged", 0)
    assert "metrics.jsonl, line 2, is no metrics" in row["reason"]
    assert set(read_tables(folder)[0]["cell"]) == {NAMES[0]}
    assert "damaged" in made.markdown.read_text()


def test_an_experiment_without_cells_has_no_report(folder: ExperimentFolder) -> None:
    begin(ExperimentFolder(folder.path.parent / "other"))
    metadata = unsealed(folder.metadata_path)
    folder.metadata_path.write_text(json.dumps(add_checksum(metadata | {"cells": []})))
    with pytest.raises(UserError, match="has no runs yet"):
        report(folder.path)


def test_reports_at_the_same_time(folder: ExperimentFolder) -> None:
    with ThreadPoolExecutor(4) as threads:
        made = list(threads.map(lambda _: report(folder.path), range(6)))

    assert len({one.html for one in made}) == 1
    assert len(read_tables(folder)[0]) == 5


def test_a_report_waits_for_another_one_for_a_limited_time(folder: ExperimentFolder) -> None:
    other = folder.hold_report()
    with pytest.raises(FileHeld, match="another process writes tables and report of"):
        folder.hold_report(patience_s=0.0)
    threading.Timer(0.3, other.close).start()
    with folder.hold_report():
        pass


def test_a_manifest_must_not_drop_cells_that_were_run(folder: ExperimentFolder) -> None:
    begin(folder, (0, 1))  # the third has not begun
    with pytest.raises(UserError) as caught:
        begin(folder, (0, 2))
    said = f"has runs of cells that are no longer in the manifest: {NAMES[1]}; put them back"
    assert said in str(caught.value)
    assert [identity.seed for identity in folder.identities()] == [0, 1]
    small = commit(folder)
    with pytest.raises(UserError, match=r"in the manifest: reach-iher-default-seed0, reach-iher-"):
        begin(small, (5,))
