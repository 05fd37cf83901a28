"""Run listeners: several as one, and TensorBoard over a crash."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from iher_robot.training.listener import EpisodeReport, RunListener, RunListeners
from iher_robot.training.tensorboard import TensorBoard

ROWS = [{"epoch": epoch, "success": epoch / 10} for epoch in (1, 2, 3)]


class Noting(RunListener):
    """Notes every call."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, Any]] = []

    def announce(self, text: str) -> None:
        self.calls.append(("announce", text))

    def resume(self, rows: Any) -> None:
        self.calls.append(("resume", rows))

    def phase(self, name: str, done: int, total: int) -> None:
        self.calls.append(("phase", (name, done, total)))

    def minutes(self, used: float) -> None:
        self.calls.append(("minutes", used))

    def tick(self, transition: Any) -> None:
        self.calls.append(("tick", transition))

    def episode(self, report: EpisodeReport) -> None:
        self.calls.append(("episode", report))

    def epoch(self, row: Any) -> None:
        self.calls.append(("epoch", row))

    @contextmanager
    def question(self) -> Iterator[None]:
        self.calls.append(("asks", None))
        yield
        self.calls.append(("asked", None))


def test_every_hook_reaches_every_listener() -> None:
    first, second = Noting(), Noting()
    both = RunListeners([first, second])
    report = EpisodeReport("motion", 1, 50, success=True, aborted="")
    transition: Any = object()
    both.announce("text")
    both.fault("the robot is lost")
    both.resume(ROWS)
    both.phase("collect", 1, 2)
    both.minutes(0.5)
    both.tick(transition)
    both.episode(report)
    both.epoch(ROWS[0])
    with both.question():
        assert first.calls[-1] == second.calls[-1] == ("asks", None)
    assert first.calls == second.calls
    assert first.calls == [
        ("announce", "text"),
        ("announce", "the robot is lost"),
        ("resume", ROWS),
        ("phase", ("collect", 1, 2)),
        ("minutes", 0.5),
        ("tick", transition),
        ("episode", report),
        ("epoch", ROWS[0]),
        ("asks", None),
        ("asked", None),
    ]


def test_tensorboard_has_every_epoch_though_a_crash_came_after_a_checkpoint(tmp_path: Path) -> None:
    with TensorBoard(tmp_path) as board:
        board.epoch(ROWS[0])  # the process dies before it writes the second, which is saved
    with TensorBoard(tmp_path) as board:
        board.resume(ROWS[:2])
        board.epoch(ROWS[2])
    events = EventAccumulator(str(tmp_path))
    events.Reload()
    found = {event.step: round(event.value, 6) for event in events.Scalars("success")}
    assert found == {1: 0.1, 2: 0.2, 3: 0.3}
