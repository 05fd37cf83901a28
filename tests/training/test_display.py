"""What the display says follows from what it was told."""

from __future__ import annotations

import io
import math
import time

import pytest
from rich.console import Console

from iher_robot.training.display import TrainingDisplay

ROW = {
    "epoch": 4,
    "robot_minutes": 4.0,
    "success": 0.425,
    "object_moved": 0.62,
    "updates": 40_000,
    "updates_per_second": 312.4,
    "imagined_transitions": 1_240_000,
}


class Clock:
    def __init__(self) -> None:
        self.seconds = 0.0

    def __call__(self) -> float:
        return self.seconds


@pytest.fixture
def clock() -> Clock:
    return Clock()


def terminal(width: int = 100) -> Console:
    return Console(file=io.StringIO(), force_terminal=True, width=width, legacy_windows=False)


def pipe() -> Console:
    return Console(file=io.StringIO(), force_terminal=False, width=20)


def written(console: Console) -> str:
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def shown(display: TrainingDisplay, width: int = 100) -> str:
    console = Console(file=io.StringIO(), width=width, record=True)
    console.print(display.render())
    return console.export_text()


def line_with(text: str, label: str) -> str:
    (line,) = [line for line in text.splitlines() if label in line]
    return line


def test_the_display_shows_minutes_phase_and_metrics(clock: Clock) -> None:
    display = TrainingDisplay(40.0, title="push [x]", console=terminal(), clock=clock)
    clock.seconds = 600.0
    display.epoch(ROW)
    display.phase("update", 1200, 10_000)
    display.minutes(4.5)
    text = shown(display)
    assert "push [x]" in text
    assert "4.50 used, 35.50 left" in line_with(text, "robot minutes")
    assert "update 1,200 of 10,000" in line_with(text, "epoch 5")
    assert "42%" in line_with(text, "success")
    assert "62%" in line_with(text, "object moved")
    assert "312" in line_with(text, "updates/s")
    assert "1,240,000" in line_with(text, "imagined")
    assert "0:10:00" in line_with(text, "elapsed")


def test_an_epoch_without_evaluation_keeps_the_last_success_and_says_whose(clock: Clock) -> None:
    display = TrainingDisplay(40.0, console=terminal(), clock=clock)
    display.epoch(ROW)
    display.epoch({"epoch": 5, "robot_minutes": 5.0})
    assert "42%" in line_with(shown(display), "success")
    assert "epoch 4" in line_with(shown(display), "success")
    assert "success -" in display.line()


def test_time_left_follows_the_pace_and_counts_down(clock: Clock) -> None:
    display = TrainingDisplay(10.0, console=terminal(), clock=clock)
    assert math.isnan(display.seconds_left)
    clock.seconds = 60.0
    display.epoch({"epoch": 1, "robot_minutes": 1.0})
    assert display.seconds_left == pytest.approx(9 * 60)
    clock.seconds = 80.0
    assert display.seconds_left == pytest.approx(9 * 60 - 20)
    clock.seconds = 10_000.0
    assert display.seconds_left == 0.0


def test_after_resuming_the_pace_is_of_this_process_only(clock: Clock) -> None:
    display = TrainingDisplay(10.0, console=terminal(), clock=clock)
    clock.seconds = 100.0
    display.resume([ROW])
    assert "42%" in line_with(shown(display), "success")
    assert math.isnan(display.seconds_left)
    clock.seconds = 130.0
    display.epoch({"epoch": 5, "robot_minutes": 5.0})
    assert display.seconds_left == pytest.approx(5 * 30)


@pytest.mark.parametrize("width", [40, 60, 80, 200])
def test_no_line_is_wider_than_the_terminal(clock: Clock, width: int) -> None:
    display = TrainingDisplay(40.0, title="push", console=terminal(width), clock=clock)
    display.epoch(ROW)
    assert max(map(len, shown(display, width).splitlines())) <= width


def test_without_a_terminal_there_is_one_plain_line_an_epoch(clock: Clock) -> None:
    console = pipe()
    with TrainingDisplay(40.0, console=console, clock=clock) as display:
        display.phase("update", 1, 2)
        display.epoch(ROW)
        display.epoch({"epoch": 5, "robot_minutes": 5.0, "success": math.nan})
    first, second = written(console).splitlines()
    assert first.startswith("epoch 4, 4.00 of 40 min, success 42%, object moved 62%")
    assert second.startswith("epoch 5, 5.00 of 40 min, success -")
    assert "\x1b" not in first


def test_on_a_terminal_the_last_state_stays(clock: Clock) -> None:
    console = terminal()
    with TrainingDisplay(40.0, console=console, clock=clock) as display:
        display.epoch(ROW)
    assert "1,240,000" in written(console)


def test_the_last_picture_says_how_the_run_ended(clock: Clock) -> None:
    with TrainingDisplay(40.0, console=terminal(), clock=clock) as done:
        done.epoch(ROW)
    assert "done" in line_with(shown(done), "│  epoch 4")
    assert "starting" not in shown(done)

    display = TrainingDisplay(40.0, console=terminal(), clock=clock)

    def stop() -> None:
        with display:
            display.epoch(ROW)
            display.phase("collect", 3, 32)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop()
    assert "stopped in collect 3 of 32" in line_with(shown(display), "│  epoch 5")


def test_a_task_without_object_has_no_line_about_it(clock: Clock) -> None:
    display = TrainingDisplay(40.0, console=terminal(), clock=clock)
    display.epoch({name: value for name, value in ROW.items() if name != "object_moved"})
    assert "object" not in shown(display)
    assert "object" not in display.line()


@pytest.mark.parametrize("minutes", [1.0, 1e-300])
def test_a_time_beyond_any_calendar_is_unknown(clock: Clock, minutes: float) -> None:
    display = TrainingDisplay(1e300, console=terminal(), clock=clock)
    clock.seconds = 60.0
    display.epoch(ROW | {"robot_minutes": minutes})
    assert display.line().endswith("- left")
    assert line_with(shown(display), "left  ").split()[2] == "-"


@pytest.mark.parametrize("make", [terminal, pipe])
def test_when_off_it_shows_nothing(clock: Clock, make: type[Console]) -> None:
    console = make()
    with TrainingDisplay(40.0, enabled=False, console=console, clock=clock) as display:
        display.phase("update", 1, 2)
        display.epoch(ROW)
    assert written(console) == ""


def test_a_question_has_the_terminal_to_itself(clock: Clock) -> None:
    console = terminal()
    with TrainingDisplay(1.0, title="push", console=console, clock=clock) as display:
        display.minutes(0.25)
        with display.question():
            before = written(console)
            time.sleep(0.6)  # more than a refresh
            assert written(console) == before
        display.minutes(0.5)
    assert "0.25 used" in before
    assert "0.50 used" in written(console)


def test_a_pause_without_a_display_changes_nothing(clock: Clock) -> None:
    console = pipe()
    with TrainingDisplay(1.0, console=console, clock=clock) as display, display.question():
        display.announce("put the cube back")
    assert written(console) == "put the cube back\n"
