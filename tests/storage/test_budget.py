"""The commands ``budget show`` and ``budget grant``."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from iher_robot.cli.app import main
from iher_robot.datasets.spending import grant, spending_of_run
from iher_robot.errors import UserError
from iher_robot.storage.ledger import Ledger
from iher_robot.training.train import resume
from tests.conftest import WholeRun
from tests.small_runs import EPOCH_MINUTES, metrics, motion_ticks, run


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory, whole_run: WholeRun) -> Path:
    return shutil.copytree(whole_run(EPOCH_MINUTES), tmp_path_factory.mktemp("budget") / "run")


def say(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main(words)
    printed = capsys.readouterr()
    return int(str(ended.value.code)), printed.out, printed.err


def budget_left_granted(run: Path) -> tuple[int, int, int]:
    """Ticks of a run's budget, of its rest, and its grants."""
    spending = spending_of_run(run)
    assert spending.budget is not None
    assert spending.left is not None
    assert spending.granted is not None
    return spending.budget.ticks, spending.left.ticks, spending.granted.ticks


def test_a_resumed_run_spends_exactly_the_grant(
    finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert budget_left_granted(finished) == (100, 0, 0)
    rows = metrics(finished)

    code, out, err = say(capsys, "budget", "grant", str(finished), "0.02")

    assert (code, err) == (0, "")
    assert [line.split() for line in out.splitlines() if "left" in line] == [["left", "30", "0.02"]]
    result = resume(finished, display=False)
    assert result.budget_minutes == pytest.approx(130 / 1500)
    assert motion_ticks(finished) == 130
    assert metrics(finished)[: len(rows)] == rows
    assert budget_left_granted(finished) == (130, 0, 30)


def test_a_grant_is_spent_even_if_the_run_had_succeeded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "run"
    monkeypatch.setattr(
        "iher_robot.training.learners.base.evaluate_learner", lambda *_, **__: {"success": 1.0}
    )
    run(out, 4 * EPOCH_MINUTES, until_success=0.5)
    assert motion_ticks(out) == 200
    resume(out, display=False)
    assert motion_ticks(out) == 200, "it has succeeded"
    grant(out, EPOCH_MINUTES)
    resume(out, display=False)
    assert motion_ticks(out) == 400, "until it succeeds twice again"


def test_a_run_in_progress_can_be_shown_but_not_granted_time(
    finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spent = spending_of_run(finished).spent["motion"].ticks
    with Ledger(finished / "ledger.sqlite") as ledger, ledger.reserve("motion", 50) as entry:
        entry.begin(3)
        code, out, _ = say(capsys, "budget", "show", str(finished))
        assert code == 0
        assert f"{spent + 3}" in out
        code, _, err = say(capsys, "budget", "grant", str(finished), "1")
        assert code == 2
        assert "in use" in err
        entry.settle(0)
    assert budget_left_granted(finished)[2] in (0, 30)


@pytest.mark.parametrize("minutes", ["0", "nan", "inf", "1e-9"])
def test_minutes_shorter_than_a_tick_are_refused(
    finished: Path, capsys: pytest.CaptureFixture[str], minutes: str
) -> None:
    before = spending_of_run(finished)
    code, _, err = say(capsys, "budget", "grant", str(finished), minutes)
    assert code == 2
    assert err.startswith("iher-robot: budget is ")
    assert spending_of_run(finished) == before


def test_a_folder_without_a_run_has_no_budget(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for words in (("show", str(tmp_path)), ("grant", str(tmp_path), "1")):
        code, _, err = say(capsys, "budget", *words)
        assert code == 2
        assert "there is no run at" in err
    code, _, err = say(capsys, "budget", "show", "there", "--robot", "fetch")
    assert code == 2
    assert "not both" in err


def test_changed_settings_are_refused(finished: Path, tmp_path: Path) -> None:
    config = finished / "config.yaml"
    text = config.read_text()
    try:
        config.write_text(text.replace("budget_minutes: 0.0667", "budget_minutes: 0.0668"))
        with pytest.raises(UserError, match=r"config\.yaml has changed since the run began"):
            spending_of_run(finished)
        with pytest.raises(UserError, match=r"config\.yaml has changed since the run began"):
            grant(finished, 1.0)
    finally:
        config.write_text(text)
    assert json.loads((finished / "metrics.jsonl").read_text().splitlines()[0])["epoch"] == 1
