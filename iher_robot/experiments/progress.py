"""What the cells of an experiment are doing: a live table, or a line for each event."""

from __future__ import annotations

import datetime
import time
from collections import Counter
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from types import TracebackType
from typing import Literal, Self

from rich import box
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from iher_robot.storage.run_directory import Row

State = Literal["waiting", "running", "finished", "interrupted", "failed"]

_ORDER: tuple[State, ...] = ("running", "failed", "interrupted", "waiting", "finished")
_STYLES: dict[State, str] = {"running": "bold", "failed": "red", "finished": "green"}
_LINES_AROUND = 7
_LINES_OF_A_FILE = 1000


@dataclass
class Line:
    """A cell on the board.

    Attributes:
        name: Its name.
        budget_minutes: Robot minutes that it may spend.
        state: What it is doing.
        note: More of that, in words.
        row: Its last metrics, and the last success rate among them.
        started: When its process began here. s
        seconds: How long that took.
    """

    name: str
    budget_minutes: float
    state: State = "waiting"
    note: str = ""
    row: Row | None = None
    started: float | None = None
    seconds: float | None = None


class Board:
    """Shows the cells.

    Args:
        title: Name of the experiment.
        console: Where to; standard output by default. If it is no terminal, it gets a line for
            each cell that begins or ends.
        enabled: Show anything at all.
        clock: Monotonic time. s
    """

    def __init__(
        self,
        title: str,
        *,
        console: Console | None = None,
        enabled: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.title = title
        self.lines: dict[str, Line] = {}
        self.console = console or Console()
        self.enabled = enabled
        self._clock = clock
        self._live: AbstractContextManager[object] = nullcontext()

    def __enter__(self) -> Self:
        if self.enabled and self.console.is_terminal:
            self._live = Live(
                get_renderable=self.render, console=self.console, refresh_per_second=2
            )
        self._live.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._live.__exit__(kind, error, trace)

    def add(self, line: Line) -> None:
        """Show another cell."""
        self.lines[line.name] = line

    def change(self, name: str, state: State, note: str = "") -> None:
        """Say what a cell does now."""
        line = self.lines[name]
        if state == "running":
            line.started = self._clock()
        elif line.started is not None:
            line.seconds = self._clock() - line.started
        line.state, line.note = state, note
        if self.enabled and not isinstance(self._live, Live):
            took = "" if line.seconds is None else f" after {_duration(line.seconds)}"
            self.say(": ".join(filter(None, [f"{name} {state}{took}", note])))

    def say(self, text: str) -> None:
        """Print a line that stays."""
        if self.enabled:
            self.console.print(text, markup=False, highlight=False, soft_wrap=True)

    def render(self) -> RenderableType:
        """The table as it is now, as far as the terminal has room for it."""
        height = self.console.height if self.console.is_terminal else _LINES_OF_A_FILE
        room = max(3, height - _LINES_AROUND)
        ordered = sorted(self.lines.values(), key=lambda line: _ORDER.index(line.state))
        table = Table(box=box.SIMPLE_HEAD, title=Text(self.title), title_justify="left")
        table.add_column("cell", overflow="ellipsis", no_wrap=True)
        table.add_column("state")
        for name in ("robot minutes", "success", "epoch", "time"):
            table.add_column(name, justify="right", no_wrap=True)
        for line in ordered[:room]:
            state = Text(line.state, style=_STYLES.get(line.state, "dim"))
            if line.note:
                state.append(f" {line.note}", style="dim")
            table.add_row(Text(line.name), state, *map(Text, self._numbers(line)))
        return Group(table, Text(self._summary(len(ordered) - room)))

    def _numbers(self, line: Line) -> tuple[str, str, str, str]:
        row = line.row or {}
        minutes = row.get("robot_minutes")
        used = "" if minutes is None else f"{minutes:.2f} of {line.budget_minutes:g}"
        success = row.get("success")
        seconds = line.seconds
        if line.state == "running" and line.started is not None:
            seconds = self._clock() - line.started
        return (
            used or f"{line.budget_minutes:g}",
            "" if success is None else f"{success:.0%}",
            str(row.get("epoch", "")),
            "" if seconds is None else _duration(seconds),
        )

    def _summary(self, hidden: int) -> str:
        counts = Counter(line.state for line in self.lines.values())
        told = ", ".join(f"{counts[state]} {state}" for state in _ORDER if counts[state])
        more = f" ({hidden} not shown)" if hidden > 0 else ""
        return f"{len(self.lines)} cells: {told}{more}"


def _duration(seconds: float) -> str:
    return str(datetime.timedelta(seconds=round(seconds)))
