"""Progress of the cells of an experiment: a live table, or a line per event."""

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
_OTHER_LINES = 7
_HEIGHT_OF_A_FILE = 1000


@dataclass
class CellProgress:
    """Progress of a cell.

    Attributes:
        name: Its name.
        budget_minutes: Budget of robot minutes.
        state: Its state.
        note: Further text about the state.
        row: Its last metrics, with the last success rate.
        started: Start of its process, on the table's clock. s
        seconds: Duration of its process. s
    """

    name: str
    budget_minutes: float
    state: State = "waiting"
    note: str = ""
    row: Row | None = None
    started: float | None = None
    seconds: float | None = None


class ProgressTable:
    """Live table of the cells.

    Args:
        title: Name of the experiment.
        console: Where to print; standard output by default. Without a terminal a line is printed
            for each cell that starts or ends.
        enabled: False prints nothing.
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
        self.cells: dict[str, CellProgress] = {}
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

    def add(self, cell: CellProgress) -> None:
        """Add a cell to the table."""
        self.cells[cell.name] = cell

    def change(self, name: str, state: State, note: str = "") -> None:
        """Change the state of a cell."""
        cell = self.cells[name]
        if state == "running":
            cell.started = self._clock()
        elif cell.started is not None:
            cell.seconds = self._clock() - cell.started
        cell.state, cell.note = state, note
        if self.enabled and not isinstance(self._live, Live):
            took = "" if cell.seconds is None else f" after {_duration(cell.seconds)}"
            self.print(": ".join(filter(None, [f"{name} {state}{took}", note])))

    def print(self, text: str) -> None:
        """Print a line above the table."""
        if self.enabled:
            self.console.print(text, markup=False, highlight=False, soft_wrap=True)

    def render(self) -> RenderableType:
        """The table as of now, cut to the height of the terminal."""
        height = self.console.height if self.console.is_terminal else _HEIGHT_OF_A_FILE
        room = max(3, height - _OTHER_LINES)
        ordered = sorted(self.cells.values(), key=lambda cell: _ORDER.index(cell.state))
        table = Table(box=box.SIMPLE_HEAD, title=Text(self.title), title_justify="left")
        table.add_column("cell", overflow="ellipsis", no_wrap=True)
        table.add_column("state")
        for name in ("robot minutes", "success", "epoch", "time"):
            table.add_column(name, justify="right", no_wrap=True)
        for cell in ordered[:room]:
            state = Text(cell.state, style=_STYLES.get(cell.state, "dim"))
            if cell.note:
                state.append(f" {cell.note}", style="dim")
            table.add_row(Text(cell.name), state, *map(Text, self._numbers(cell)))
        return Group(table, Text(self._summary(len(ordered) - room)))

    def _numbers(self, cell: CellProgress) -> tuple[str, str, str, str]:
        row = cell.row or {}
        minutes = row.get("robot_minutes")
        used = "" if minutes is None else f"{minutes:.2f} of {cell.budget_minutes:g}"
        success = row.get("success")
        seconds = cell.seconds
        if cell.state == "running" and cell.started is not None:
            seconds = self._clock() - cell.started
        return (
            used or f"{cell.budget_minutes:g}",
            "" if success is None else f"{success:.0%}",
            str(row.get("epoch", "")),
            "" if seconds is None else _duration(seconds),
        )

    def _summary(self, hidden: int) -> str:
        counts = Counter(cell.state for cell in self.cells.values())
        states = ", ".join(f"{counts[state]} {state}" for state in _ORDER if counts[state])
        more = f" ({hidden} not shown)" if hidden > 0 else ""
        return f"{len(self.cells)} cells: {states}{more}"


def _duration(seconds: float) -> str:
    return str(datetime.timedelta(seconds=round(seconds)))
