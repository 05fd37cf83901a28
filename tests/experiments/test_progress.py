"""The table of cells, and the lines that stand for it where there is no terminal."""

from __future__ import annotations

import io
import re

from rich.console import Console

from iher_robot.experiments.progress import Board, Line


def board(*lines: Line, height: int = 40) -> tuple[Board, Console]:
    console = Console(file=io.StringIO(), width=100, height=height, force_terminal=height < 40)
    made = Board("Push [of a block]", console=console, clock=iter(range(0, 1000, 60)).__next__)
    for line in lines:
        made.add(line)
    return made, console


def shown(made: Board) -> str:
    with made.console.capture() as capture:
        made.console.print(made.render())
    return capture.get()


def test_each_event_is_a_line() -> None:
    made, console = board(Line("push-[a]-seed0", 60.0))

    made.change("push-[a]-seed0", "running")
    made.change("push-[a]-seed0", "failed", "exit code 2")

    assert isinstance(console.file, io.StringIO)
    assert console.file.getvalue() == (
        "push-[a]-seed0 running\npush-[a]-seed0 failed after 0:01:00: exit code 2\n"
    )


def test_a_quiet_board_says_nothing() -> None:
    made, console = board(Line("a", 1.0))
    made.enabled = False

    made.change("a", "running")
    made.say("something")

    assert isinstance(console.file, io.StringIO)
    assert console.file.getvalue() == ""


def test_the_table_has_what_runs_first_and_says_what_it_leaves_out() -> None:
    lines = [Line(f"cell{number}", 4.0) for number in range(9)]
    made, _ = board(*lines, height=12)
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
