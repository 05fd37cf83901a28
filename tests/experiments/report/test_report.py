"""Tables and report of an experiment."""

from __future__ import annotations

import base64
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from iher_robot.errors import UserError
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.experiments.grid import Cell, expand
from iher_robot.experiments.manifest import read_manifest
from iher_robot.experiments.report.report import report
from iher_robot.storage.run_result import RunResult, write_result
from tests.experiments.small import write_manifest
from tests.run_folders import make_run

pytest.importorskip("pandas")

# Rates at 1, 2, 3 and 4 robot minutes, by algorithm and seed.
RATES = {
    ("her", 0): (0.0, 0.1, 0.2, 0.4),
    ("her", 1): (0.0, 0.2, 0.6, 0.95),
    ("iher", 0): (0.1, 0.6, 0.9, 1.0),
    ("iher", 1): (0.2, 0.95, 1.0, 0.9),
}


def make_cell(
    folder: ExperimentFolder, cell: Cell, rates: tuple[float, ...], **result: Any
) -> None:
    """Create the folder of a run after a number of evaluations."""
    run = folder.run(cell.name)
    identity = cell.identity
    make_run(run.path, task=identity.task, seed=identity.seed, budget_minutes=4.0)
    for epoch, rate in enumerate(rates, start=1):
        run.append_metrics(
            {
                "epoch": epoch,
                "robot_minutes": float(epoch),
                "success": rate,
                "episodes": 30 * epoch,
                "updates": 100 * epoch,
                "wall_seconds": 10.0 * epoch,
            }
        )
        run.append_metrics({"epoch": epoch, "robot_minutes": epoch + 0.5, "wall_seconds": 0.0})
    if result:
        minutes = float(len(rates))
        write_result(
            run.result_path, RunResult(4, minutes, 4.0, rates[-1], wall_seconds=40.0, **result)
        )


@pytest.fixture
def folder(tmp_path: Path) -> ExperimentFolder:
    return make_folder(tmp_path, description="Of | two.")


def make_folder(tmp_path: Path, description: str) -> ExperimentFolder:
    path = tmp_path / "m.yaml"
    grid = {"algos": ["her", "iher"], "presets": ["default"], "budgets": [4], "seeds": [0, 1, 2]}
    manifest = read_manifest(
        write_manifest(path, grid, title="What is <b>it</b>?", description=description)
    )
    made = ExperimentFolder(tmp_path / "out")
    with made.hold():
        cells = expand(manifest)
        provenance = {"command": ["iher-robot", "experiment", "m.yaml"]}
        made.begin(manifest, provenance, [cell.identity for cell in cells])
        for cell in cells:
            rates = RATES.get((cell.identity.algo, cell.identity.seed))
            if rates is not None:
                make_cell(made, cell, rates, final_successes=90, final_episodes=100)
    return made


def rows_of(text: str, first: str) -> list[list[str]]:
    """Rows of the table whose header begins with a word."""
    rows: list[list[str]] = []
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if rows and not line.startswith("|"):
            return rows
        if rows or (line.startswith("|") and cells[0] == first):
            rows.append(cells)
    return rows


def test_the_numbers_of_a_report(folder: ExperimentFolder) -> None:
    made = report(folder.path)

    text = made.markdown.read_text()
    head, _, her, iher = rows_of(text, "method")
    assert dict(zip(head, her, strict=True)) == {
        "method": "her",
        "seeds": "2 of 3 finished",
        "min to 50 %": "**not in 3.5** (not in 4.0, 3.0)",
        "min to 90 %": "**not in 4.0** (not in 4.0, 4.0)",
        "HER's min / its, to 90 %": "-",
        "last evaluation, IQM": "68 % (40 to 95)",
        "mean": "",
        "each seed, %": "40, 95",
        "final policy, fresh episodes": "90 of 100, 90 of 100",
        "robot min": "4.0 (stops at 100 %)",
        "evaluated every": "1.0 min, 50 episodes",
        "wall clock": "0:00:00",
    }
    assert iher[:5] == [
        *("iher", "2 of 3 finished", "**2.0** (2.0, 2.0)", "**2.5** (3.0, 2.0)", "> 1.4")
    ]
    assert "HER is `her` as published: her." in text
    assert "**4 of 6 runs have finished**, 2 not begun." in text
    assert "No evaluation yet: reach-her-default-seed2, reach-iher-default-seed2." in text
    assert "iher-robot experiment m.yaml" in text
    assert "c0ffee" in text


def test_the_tables_are_tidy(folder: ExperimentFolder) -> None:
    import pandas as pd

    made = report(folder.path)

    table = pd.read_csv(made.table)
    assert len(table) == 16, "a row for each evaluation, none for other epochs"
    row = table[(table.cell == "reach-iher-default-seed1") & (table.epoch == 2)].iloc[0]
    assert (row.task, row.algo, row.preset, row.seed) == ("reach", "iher", "default", 1)
    assert (row.robot_minutes, row.success, row.episodes, row.updates) == (2.0, 0.95, 60, 200)
    parquet = pd.read_parquet(made.table.with_suffix(".parquet"))
    assert parquet.success.tolist() == table.success.tolist()
    assert len(pd.read_csv(folder.runs_path)) == 6


def test_a_report_is_made_again_from_its_tables_alone(
    folder: ExperimentFolder, tmp_path: Path
) -> None:
    first = report(folder.path)
    small = tmp_path / "committed"
    small.mkdir()
    for path in (folder.metadata_path, folder.evaluations_path, folder.runs_path):
        shutil.copy(path, small)

    again = report(small)

    def content(path: Path) -> str:
        return re.sub("Made on .* by", "", path.read_text())

    assert content(again.markdown) == content(first.markdown)
    assert content(again.html) == content(first.html)


def test_the_page_is_self_contained_and_escapes_text(folder: ExperimentFolder) -> None:
    page = report(folder.path).html.read_text()

    assert "What is &lt;b&gt;it&lt;/b&gt;?" in page
    assert "<b>it" not in page
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert len(pictures) == 2 == page.count("<img")
    assert all(base64.b64decode(picture).startswith(b"\x89PNG") for picture in pictures)
    assert "http" not in page


def test_an_image_that_is_no_figure_of_the_report_is_text(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("a secret")
    made = make_folder(
        tmp_path, description=f"![one]({secret}) ![two](http://example.com/a.png) *three*"
    )

    page = report(made.path).html.read_text()

    assert "one two <em>three</em>" in page
    assert base64.b64encode(b"a secret").decode() not in page
    assert "http" not in page
    assert page.count("<img") == 2


def test_no_experiment(tmp_path: Path, folder: ExperimentFolder) -> None:
    with pytest.raises(UserError, match=r"it has no experiment\.json"):
        report(tmp_path)
    report(folder.path)
    shutil.rmtree(folder.cells_path)
    folder.evaluations_path.write_text("a,b\n1,2\n")
    with pytest.raises(UserError, match="is no table of an experiment"):
        report(folder.path)
