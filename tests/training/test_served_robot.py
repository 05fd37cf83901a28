"""Learning on a served robot, through the command line and over the loss of its host."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from iher_robot.storage.ledger import Ledger
from tests.served.served_robot import PATIENT, ServedRobot, eventually, free_port

pytestmark = pytest.mark.real_time

BUDGET_MINUTES = 0.12
BUDGET_TICKS = 180


def _train(served: ServedRobot, out: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "iher_robot", "train", "--driver", "zenoh", "--task", "reach"]
    command += ["--connect", served.endpoint, "--budget-minutes", str(BUDGET_MINUTES)]
    command += ["--until-success", "off", "--out", str(out), "--quiet"]
    for setting in ("evaluation.robot_episodes=1", "learner.schedule.updates_per_step=1"):
        command += ["--set", setting]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def _episodes(out: Path) -> int:
    return len(list((out / "episodes").glob("*.npz"))) if out.exists() else 0


def test_a_run_goes_on_when_its_robot_comes_back(tmp_path: Path) -> None:
    port, out = free_port(), tmp_path / "run"
    with ServedRobot(tmp_path / "memory", *PATIENT, port=port) as first:
        run = _train(first, out)
        try:
            assert eventually(lambda: _episodes(out) >= 1, 60.0), "it collects"
            first.kill()
            before = _episodes(out)
            with ServedRobot(tmp_path / "memory", *PATIENT, port=port):
                printed, _ = run.communicate(timeout=180.0)
        finally:
            run.kill()
    assert run.returncode == 0, printed
    assert _episodes(out) > before
    rows = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    assert rows[-1]["robot_minutes"] * 1500 >= BUDGET_TICKS - 1
    with Ledger(out / "ledger.sqlite") as ledger:
        spent = ledger.spent_ticks("motion")
    assert BUDGET_TICKS <= spent <= BUDGET_TICKS + 10, "what passed unseen is charged as well"
    assert (out / "policy.pt").is_file()
