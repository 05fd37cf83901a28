"""A run's folder is created once, and its metrics survive crashes and resumptions."""

from __future__ import annotations

import math
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from iher_robot.errors import UserError
from iher_robot.storage.ledger import Ledger
from iher_robot.storage.run_directory import RunDirectory, default_run_path


@pytest.fixture
def run(tmp_path: Path) -> RunDirectory:
    run = RunDirectory.create(tmp_path / "runs" / "one", "seed: 3\n")
    Ledger(run.ledger_path).close()
    return run


def test_a_new_run_keeps_its_settings_and_can_be_opened(run: RunDirectory) -> None:
    opened = RunDirectory.open(run.path)
    assert yaml.safe_load(opened.config_path.read_text()) == {"seed": 3}
    assert opened.read_metrics() == []


def test_settings_that_were_changed_are_refused(run: RunDirectory) -> None:
    text = run.config_path.read_text()
    for changed in (text.replace("3", "4"), text.replace("sha256", "sha"), "seed: 3\n", text[1:]):
        run.config_path.write_text(changed)
        with pytest.raises(UserError, match=r"config\.yaml has changed since the run began"):
            RunDirectory.open(run.path)


def test_an_empty_folder_may_be_used(tmp_path: Path) -> None:
    RunDirectory.create(tmp_path, "seed: 3\n")
    assert RunDirectory.open(tmp_path).config_path.read_text().startswith("seed: 3\n")


def test_a_folder_that_is_not_empty_is_refused(run: RunDirectory) -> None:
    with pytest.raises(UserError, match=r"not empty.*--resume .*one.*--out"):
        RunDirectory.create(run.path, "seed: 4\n")
    assert run.config_path.read_text().startswith("seed: 3\n")


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match=r"file is a file; .*--out"):
        RunDirectory.create(tmp_path / "file", "")
    with pytest.raises(UserError, match=r"cannot create run folder .*file/below.*--out"):
        RunDirectory.create(tmp_path / "file" / "below", "")


def test_a_folder_that_cannot_be_written_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*arguments: object) -> None:
        raise PermissionError(13, "Permission denied")

    # As root, no permission bits refuse.
    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", refuse)
        with pytest.raises(UserError, match=r"cannot write .*config\.yaml: Permission denied"):
            RunDirectory.create(tmp_path / "run", "")
    RunDirectory.create(tmp_path / "run", "seed: 0\n").check_config()  # nothing was left in the way


@pytest.mark.parametrize("missing", ["config.yaml", "ledger.sqlite"])
def test_a_run_without_config_or_ledger_cannot_be_resumed(run: RunDirectory, missing: str) -> None:
    run.episodes_path.mkdir(exist_ok=True)  # the run has begun
    (run.path / missing).unlink()
    with pytest.raises(UserError, match=f"no {missing}"):
        RunDirectory.open(run.path)


def test_a_missing_run_folder_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"no run folder at .*absent"):
        RunDirectory.open(tmp_path / "absent")
    with pytest.raises(UserError, match=r"no config\.yaml"):
        RunDirectory.open(tmp_path)


def test_metrics_are_read_back_as_plain_numbers(run: RunDirectory) -> None:
    run.append_metrics({"epoch": 1, "success": np.float32(0.5), "loss": torch.tensor(2.0)})
    run.append_metrics({"epoch": 2, "loss": math.nan, "error": math.inf, "steps": (1, 10)})
    assert run.read_metrics() == [
        {"epoch": 1, "success": 0.5, "loss": 2.0},
        {"epoch": 2, "loss": None, "error": None, "steps": [1, 10]},
    ]


def test_a_line_cut_off_by_a_crash_does_not_spoil_the_next(run: RunDirectory) -> None:
    run.append_metrics({"epoch": 1})
    with run.metrics_path.open("ab") as file:
        file.write(b'{"epoch": 2, "suc')
    assert run.read_metrics() == [{"epoch": 1}]
    run.append_metrics({"epoch": 2})
    assert run.read_metrics() == [{"epoch": 1}, {"epoch": 2}]


@pytest.mark.parametrize("line", [b"{", b"3", b"\xff\xfe", b""])
def test_a_damaged_line_is_named(run: RunDirectory, line: bytes) -> None:
    run.append_metrics({"epoch": 1})
    with run.metrics_path.open("ab") as file:
        file.write(line + b"\n")
    with pytest.raises(UserError, match=r"metrics\.jsonl, line 2"):
        run.read_metrics()


def test_metrics_are_replaced_by_those_of_a_checkpoint(run: RunDirectory) -> None:
    for epoch in range(1, 6):
        run.append_metrics({"epoch": epoch, "success": epoch / 7})
    kept = run.read_metrics()[:3]
    run.replace_metrics(kept)
    assert run.read_metrics() == kept
    run.append_metrics({"epoch": 4})
    assert [row["epoch"] for row in run.read_metrics()] == [1, 2, 3, 4]
    run.replace_metrics([])
    assert run.read_metrics() == []


def test_a_run_that_died_before_its_first_move_can_be_resumed(run: RunDirectory) -> None:
    run.ledger_path.unlink(missing_ok=True)
    assert RunDirectory.open(run.path).config_path == run.config_path


def test_the_default_folder_names_the_run() -> None:
    now = datetime(2025, 1, 31, 12, 5, 9)
    path = default_run_path("push", "iher", "my/fast.yaml", 3, Path("runs"), now)
    assert path == Path("runs/push-iher-fast-seed3-20250131-120509")
