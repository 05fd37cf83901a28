"""Provenance of runs, and trials, in a report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from iher_robot.errors import UserError
from iher_robot.experiments.report import provenance
from iher_robot.experiments.report.tables import trial_rows

ROW: dict[str, Any] = {
    "cell": "reach-her-seed0",
    "state": "finished",
    "reason": "",
    "robot": "mujoco fetch-mocap",
    "robot_minutes": 4.0,
    "wall_seconds": 61.0,
    "command": "iher-robot train --set 'a=[1, 2]'",
    "processes": 1,
    "commit": "a" * 40,
    "dirty": False,
    "cpu": "A CPU",
    "cores": "2",
    "system": "Linux",
    "python": "3.11.7",
    "iher_robot": "0.1.0",
    "torch": "2.13.0",
    "mujoco": "3.11.0",
    "gymnasium_robotics": "1.4.0",
    "numpy": "2.4.6",
}
METADATA = {
    "manifest": "reach",
    "processes": [{"command": ["iher-robot", "experiment", "my file.yaml", "--only", "*-seed0"]}],
}


def test_a_run_resumed_on_another_machine_names_both() -> None:
    row = ROW | {
        "processes": 3,
        "commit": f"{'a' * 40}, {'b' * 40}",
        "dirty": True,
        "cpu": "A CPU, " + "B" * 80,
        "torch": "2.12.0, 2.13.0",
    }

    assert provenance.run_row(row)[4:] == [
        "aaaaaaaaaa, bbbbbbbbbb, with changes",
        "`iher-robot train --set 'a=[1, 2]'`, resumed 2 times",
    ]
    facts = provenance.facts(METADATA, [row])
    assert facts[1] == f"Commit: {'a' * 40}, {'b' * 40}, with changes"
    assert "iher-robot 0.1.0, torch 2.12.0, 2.13.0, mujoco 3.11.0" in facts[2]
    assert facts[3] == f"Machine: A CPU, {'B' * 60}, 2 cores, Linux; one core a run"


def test_runs_without_numbers_say_why() -> None:
    damaged = dict.fromkeys(ROW) | {
        "cell": "a",
        "state": "damaged",
        "reason": "no metrics | in line 2",
        "robot": "r",
        "commit": "",
    }
    failed = ROW | {"state": "failed", "reason": "exit code 1"}

    assert provenance.run_row(damaged)[1:3] == ["damaged: no metrics \\| in line 2", ""]
    assert provenance.run_row(failed)[1] == "failed: exit code 1"
    assert provenance.state([ROW, damaged, failed, failed]).startswith(
        "**1 of 4 runs have finished**, 1 damaged, 2 failed."
    )
    assert provenance.facts(METADATA, [damaged])[1:4] == [
        "Commit: -",
        "Versions: -",
        "Machine: -; one core a run",
    ]


@pytest.mark.parametrize(("processes", "said"), [(1, ""), (2, ", resumed once")])
def test_a_command_says_how_often_its_run_was_resumed(processes: int, said: str) -> None:
    row = ROW | {"command": "iher-robot train", "processes": processes}
    assert provenance.run_row(row)[5] == f"`iher-robot train`{said}"


def test_commands_can_be_pasted() -> None:
    assert provenance.commands(METADATA) == [
        "iher-robot experiment 'my file.yaml' --only '*-seed0'"
    ]


def test_trials_are_sorted_best_first(tmp_path: Path) -> None:
    path = tmp_path / "trials.csv"
    assert trial_rows(path) == []

    path.write_text("trial,state,minutes-to-success,a|b\n0,complete,2.50001,x\n1,running,,y\n")
    assert trial_rows(path) == [
        ["trial", "state", "minutes-to-success", "a\\|b"],
        ["0", "complete", "2.5", "x"],
        ["1", "running", "", "y"],
    ]
    path.write_text("trial,state,success-at-budget\n0,complete,0.2\n1,complete,0.9\n")
    assert [row[0] for row in trial_rows(path)] == ["trial", "1", "0"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is no table of trials"),
        ("a,b\n", "is no table of trials"),
        ("trial,state\n", "is no table of trials"),
        ("trial,state,minutes-to-success\n0,complete\n", "is no table of trials"),
        ("trial,state,minutes-to-success\n0,complete,soon\n", "a value that is no number"),
    ],
)
def test_a_damaged_table_of_trials(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "trials.csv").write_text(text)

    with pytest.raises(UserError, match=said):
        trial_rows(tmp_path / "trials.csv")
