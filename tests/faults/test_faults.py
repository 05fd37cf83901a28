"""The short form of ``make faults``: one kill of each important kind, and a run to its end."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import pytest

from tests.faults.moments import Kind
from tests.repository import ROOT

pytestmark = pytest.mark.real_time

KINDS = (
    Kind.FULL_DISK,
    Kind.JUMPING_CLOCK,
    Kind.SEALING,
    Kind.CHECKPOINT,
    Kind.EPISODE,
)
_BUDGET_MINUTES = "0.06"
_SEED = "111"
"""A seed whose moments are early and within one run."""


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Report of the harness, which exits with 1 at the first violation."""
    folder = tmp_path_factory.mktemp("faults")
    out = folder / "faults.json"
    command = [sys.executable, "-m", "tests.faults", "--kills", str(len(KINDS)), "--seed", _SEED]
    command += [word for kind in KINDS for word in ("--only", kind.name)]
    command += ["--budget-minutes", _BUDGET_MINUTES, "--folder", str(folder), "--out", str(out)]
    root = ROOT
    done = subprocess.run(
        command, cwd=root, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return dict(json.loads(out.read_text()))


def test_runs_that_are_killed_lose_no_tick_and_finish(report: dict[str, Any]) -> None:
    kills = report["kills in all"]
    assert kills == len(KINDS) - len(report["not run"])
    assert report["runs finished"] >= 1
    assert report["ticks with a command in force"] >= 90
    assert report["of these in flight at a kill, in no episode"] <= kills
    assert report["worst over-count of a ledger, ticks"] <= kills


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_kill_was_made(report: dict[str, Any], kind: Kind) -> None:
    if kind in report["not run"]:
        pytest.skip(f"kills {kind} are not possible here: {report['not run'][kind]}")
    assert report["kills"][kind] == 1
