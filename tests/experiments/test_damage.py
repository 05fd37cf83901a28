"""Damaged tables and files of an experiment."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from iher_robot.errors import UserError
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.experiments.report.report import report
from iher_robot.storage.files.checksum import add_checksum
from tests.experiments.made import commit, make_experiment, unsealed

pytest.importorskip("pandas")


@pytest.fixture
def folder(tmp_path: Path) -> ExperimentFolder:
    return make_experiment(tmp_path / "out")


def replaced(old: str, new: str) -> Callable[[str], str]:
    def change(text: str) -> str:
        assert old in text
        return text.replace(old, new)

    return change


def lines(*wanted: int) -> Callable[[str], str]:
    return lambda text: "".join(text.splitlines(keepends=True)[line] for line in wanted)


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("runs.csv", lambda text: text[:-20], "its last line is cut off"),
        ("runs.csv", lambda text: "", "its last line is cut off"),
        ("runs.csv", lines(0), "it has no rows"),
        ("runs.csv", lines(0, 1, 2), "rows of cell reach-iher-default-seed0 is 3, allowed: 2, the"),
        ("runs.csv", lines(0, 1, 2, 3, 1), "it has 2 rows of cell reach-iher-default-seed0"),
        ("runs.csv", replaced("seed2", "seed9"), "a row of 'reach-iher-default-seed9', no cell"),
        (
            "runs.csv",
            replaced("default,,,1", "default,,,"),
            "seed of cell reach-iher-default-seed1",
        ),
        ("runs.csv", replaced("default,,,1", "default,x,,1"), "variant of cell"),
        ("runs.csv", replaced("finished", "finishd"), "state of cell reach-iher-default-seed0 is"),
        ("runs.csv", replaced("interrupted,,3,3,", "interrupted,,,3,"), "epochs of cell"),
        ("runs.csv", replaced("interrupted,,3,3,", "interrupted,,3,2,"), "of runs has 2"),
        ("runs.csv", replaced("2.0,0.95,", "2.0,9.5,"), "is 9.5, allowed: 0 to 1"),
        ("runs.csv", replaced(",90,100,", ",190,100,"), "final_successes of cell"),
        ("runs.csv", replaced("evaluations", "evaluation"), "it has no column evaluations"),
        ("runs.csv", replaced("interrupted,,3,3,", "interrupted,,x,3,"), "damaged: "),
        ("evaluations.csv", lines(0), "it has 0 rows of cell reach-iher-default-seed0, where"),
        ("evaluations.csv", lines(0, 1, 2, 3), "it has 1 rows of cell reach-iher-default-seed1"),
        ("evaluations.csv", lines(0, 1, 1, 3, 4, 5), "two rows of cell reach-iher-default-seed0"),
        ("evaluations.csv", lambda text: text[:-9], "its last line is cut off"),
        ("evaluations.csv", lambda text: "\0" + text, "it has no column cell"),
        (
            "evaluations.csv",
            replaced(",0.95,", ",,"),
            "success of cell reach-iher-default-seed0 is",
        ),
        ("evaluations.csv", replaced(",0.95,", ",-0.1,"), "is -0.1, allowed: 0 to 1"),
        ("evaluations.csv", replaced(",2.0,0.95,", ",0.0,0.95,"), "robot_minutes of cell"),
        ("evaluations.csv", replaced(",2.0,0.95,", ",inf,0.95,"), "robot_minutes of cell"),
        ("evaluations.csv", replaced(",2.0,0.95,50,", ",2.0,0.95,,"), "evaluation_episodes of"),
    ],
)
def test_a_damaged_table_is_one_sentence(
    folder: ExperimentFolder, name: str, change: Callable[[str], str], said: str
) -> None:
    small = commit(folder)
    path = small.path / name
    path.write_text(change(path.read_text()))

    with pytest.raises(UserError) as caught:
        report(small.path)

    assert said in str(caught.value)
    assert str(small.path) in str(caught.value)
    assert "restore both tables from a copy" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_table_that_is_not_text(folder: ExperimentFolder) -> None:
    small = commit(folder)
    small.runs_path.write_bytes(b"\xff\xfe\x00\n")
    with pytest.raises(UserError, match="is no table of an experiment, or damaged"):
        report(small.path)


@pytest.mark.parametrize("key", ["title", "description", "manifest", "processes", "cells"])
def test_metadata_without_a_key(folder: ExperimentFolder, key: str) -> None:
    metadata = unsealed(folder.metadata_path)
    del metadata[key]
    folder.metadata_path.write_text(json.dumps(add_checksum(metadata)))
    with pytest.raises(UserError, match=rf"experiment\.json is no .*: {key}: Field required"):
        report(folder.path)


def test_metadata_with_a_wrong_cell(folder: ExperimentFolder) -> None:
    metadata = unsealed(folder.metadata_path)
    cells = metadata["cells"]
    for wrong, said in (
        ([cells[0] | {"seed": "0"}], r"cells\.0\.seed: "),
        ([cells[0], cells[0]], "names the cell reach-iher-default-seed0 twice"),
    ):
        folder.metadata_path.write_text(json.dumps(add_checksum(metadata | {"cells": wrong})))
        with pytest.raises(UserError, match=said):
            report(folder.path)
