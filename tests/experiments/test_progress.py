"""Progress table of cells, and its lines without a terminal."""

from __future__ import annotations

import io
import re

from rich.console import Console

from iher_robot.experiments.progress import CellProgress, ProgressTable


def progress(*lines: CellProgress, height: int = 40) -> tuple[ProgressTable, Console]:
    console = Console(file=io.StringIO(), width=100, height=height, force_terminal=height < 40)
    made = ProgressTable(
        "Push [of a block]", console=console, clock=iter(range(0, 1000, 60)).__next__
    )
    for line in lines:
        made.add(line)
    return made, console


def shown(made: ProgressTable) -> str:
    with made.console.capture() as capture:
        made.console.print(made.render())
    return capture.get()


def test_each_event_is_a_line() -> None:
    made, console = progress(CellProgress("push-[a]-seed0", 60.0))

    made.change("push-[a]-seed0", "running")
    made.change("push-[a]-seed0", "failed", "exit code 2")

    assert isinstance(console.file, io.StringIO)
    assert console.file.getvalue() == (
        "push-[a]-seed0 running\npush-[a]-seed0 failed after 0:01:00: exit code 2\n"
    )


def test_a_disabled_table_prints_nothing() -> None:
    made, console = progress(CellProgress("a", 1.0))
    made.enabled = False

    made.change("a", "running")
    made.print("something")

    assert isinstance(console.file, io.StringIO)
    assert console.file.getvalue() == ""


def test_the_table_shows_running_cells_first_and_counts_hidden_ones() -> None:
    lines = [CellProgress(f"cell{number}", 4.0) for number in range(9)]
    made, _ = progress(*lines, height=12)
    lines[8].state, lines[8].row = "running", {"epoch": 3, "robot_minutes": 1.2, "success": 0.5}
    lines[7].state, lines[7].note = "failed", "killed by SIGKILL"
    lines[0].state = "finished"

    table = shown(made).splitlines()

    assert "Push [of a block]" in table[0]
    assert re.findall(r"\bcell\d", "\n".join(table)) == [
        "cell8",
        "cell7",
        "cell1",
        "cell2",
        "cell3",
    ]
    assert "1.20 of 4" in next(line for line in table if "cell8" in line)
    assert "50%" in next(line for line in table if "cell8" in line)
    assert "killed by SIGKILL" in next(line for line in table if "cell7" in line)
    assert table[-1] == "9 cells: 1 running, 1 failed, 6 waiting, 1 finished (4 not shown)"
