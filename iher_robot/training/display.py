"""Terminal display of a training run: live on a terminal, one line an epoch elsewhere."""

from __future__ import annotations

import datetime
import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from types import TracebackType

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from iher_robot.training.listener import Row, RunListener

UNKNOWN = "-"
_PACE_EPOCHS = 5
_REFRESHES_PER_SECOND = 4
_WIDTH = 88
_LABEL_WIDTH = 13
_REMARK_WIDTH = 60


class TrainingDisplay(RunListener):
    """Shows progress and success of a run.

    Example:
        >>> with TrainingDisplay(40.0, title="push") as display:
        ...     display.phase("collect", 3, 32)
        ...     display.epoch({"epoch": 1, "robot_minutes": 1.1, "success": 0.05})

    Args:
        budget_minutes: Robot minutes granted.
        title: What is trained.
        enabled: Show anything at all.
        console: Where to; standard output by default. If it is no terminal, it gets one line an
            epoch.
        clock: Monotonic time. s
    """

    def __init__(
        self,
        budget_minutes: float,
        *,
        title: str = "",
        enabled: bool = True,
        console: Console | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.budget_minutes = budget_minutes
        self.title = title
        self.enabled = enabled
        self.console = console or Console()
        self._clock = clock
        self._used = 0.0
        self._phase = ("starting", 0, 0)
        self._done = False
        self._row: Row = {}
        self._evaluated: Row = {}
        self._started = clock()
        self._history = deque([(self._started, 0.0)], maxlen=_PACE_EPOCHS + 1)
        self._live: AbstractContextManager[object] = nullcontext()

    def __enter__(self) -> TrainingDisplay:
        if self.enabled and self.console.is_terminal:
            self._live = self._make_live()
        self._live.__enter__()
        return self

    def _make_live(self) -> Live:
        return Live(
            get_renderable=self.render,
            console=self.console,
            refresh_per_second=_REFRESHES_PER_SECOND,
        )

    @contextmanager
    def question(self) -> Iterator[None]:
        """Pause the live display while the terminal shows a question."""
        self._live.__exit__(None, None, None)
        try:
            yield
        finally:
            if isinstance(self._live, Live):
                self._live = self._make_live()
            self._live.__enter__()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # What the live display shows last stays on the terminal.
        self._done = kind is None
        if not self._done:
            name, done, total = self._phase
            self._phase = (f"stopped in {name}" if total else "stopped", done, total)
        self._live.__exit__(kind, error, trace)

    def announce(self, text: str) -> None:
        """Print a line that stays, above the display."""
        if self.enabled:
            self.console.print(text, markup=False, highlight=False, soft_wrap=True)

    def resume(self, rows: Sequence[Row]) -> None:
        """Take over the last row of a run that goes on; time counts from here."""
        self._remember(rows[-1])
        self._history.clear()
        self._history.append((self._clock(), self._used))

    def minutes(self, used: float) -> None:
        """Update the robot minutes within an epoch."""
        self._used = used

    def phase(self, name: str, done: int, total: int) -> None:
        """Show the phase; cheap enough for every update.

        Args:
            name: Such as ``"collect"``, ``"dynamics"``, ``"imagine"``, ``"update"``,
                ``"evaluate"``.
            done: Parts done.
            total: Parts of the phase in this epoch.
        """
        self._phase = (name, done, total)

    def epoch(self, row: Row) -> None:
        """End an epoch.

        Args:
            row: Metrics. Used are ``epoch``, ``robot_minutes``, ``success``, ``object_moved``,
                ``updates``, ``updates_per_second`` and ``imagined_transitions``, as far as
                they are there.
        """
        self._remember(row)
        self._history.append((self._clock(), self._used))
        self._phase = ("starting", 0, 0)
        if self.enabled and not self.console.is_terminal:
            self.console.print(self.line(), markup=False, highlight=False, soft_wrap=True)

    def _remember(self, row: Row) -> None:
        self._row = dict(row)
        self._used = row.get("robot_minutes", self._used)
        if "success" in row:
            self._evaluated = self._row

    @property
    def seconds_left(self) -> float:
        """Wall-clock seconds until the budget is spent, at the pace of the last epochs; or NaN."""
        (first, used_first), (last, used_last) = self._history[0], self._history[-1]
        if used_last <= used_first:
            return math.nan
        pace = (last - first) / (used_last - used_first)
        since = self._clock() - last
        return max(0.0, pace * (self.budget_minutes - used_last) - since)

    def line(self) -> str:
        """The last epoch in one line of plain text."""
        parts = [
            f"epoch {_count(self._row.get('epoch'))}",
            f"{self._used:.2f} of {self.budget_minutes:g} min",
            f"success {_percent(self._row.get('success'))}",
            *([f"object moved {_percent(self._row['object_moved'])}"] if self._has_object else []),
            f"{_count(self._row.get('updates_per_second'))} updates/s",
            f"{_count(self._row.get('imagined_transitions'))} imagined",
            f"{self._elapsed()} elapsed",
            f"{_duration(self.seconds_left)} left",
        ]
        return ", ".join(parts)

    def render(self) -> RenderableType:
        """The display as it is now."""
        name, done, total = ("done", 1, 1) if self._done else self._phase
        width = min(_WIDTH, self.console.width)
        bars = Table.grid(padding=(0, 2), expand=True)
        bars.add_column(style="dim", min_width=_LABEL_WIDTH)
        bars.add_column(ratio=1)
        bars.add_column(style="bold", no_wrap=True)
        left = max(0.0, self.budget_minutes - self._used)
        used = f"{self._used:.2f} used, {left:.2f} left"
        bars.add_row("robot minutes", _bar(self._used, self.budget_minutes), used)
        counted = total and not self._done
        working = f"{name} {_count(done)} of {_count(total)}" if counted else name
        number = _count(self._row.get("epoch", 0) + (0 if self._done else 1))
        bars.add_row(f"epoch {number}", _bar(done, total), working)

        numbers = Table.grid(padding=(0, 2))
        numbers.add_column(style="dim", min_width=_LABEL_WIDTH)
        numbers.add_column(style="bold", justify="right", min_width=10)
        numbers.add_column(style="dim", no_wrap=True)
        for label, value, remark in self._numbers():
            numbers.add_row(label, value, remark if width >= _REMARK_WIDTH else "")

        # A Text: in a string, brackets of a path would be markup.
        title = Text(f"iher-robot train: {self.title}" if self.title else "iher-robot train")
        return Panel(
            Group(bars, "", numbers), title=title, title_align="left", padding=(1, 2), width=width
        )

    def _numbers(self) -> list[tuple[str, str, str]]:
        evaluated, row = self._evaluated, self._row
        judged = f"in the evaluation of epoch {_count(evaluated['epoch'])}" if evaluated else ""
        updates = f"{_count(row['updates'])} in all" if "updates" in row else ""
        numbers = [("success", _percent(evaluated.get("success")), judged)]
        if self._has_object:
            moved = _percent(row["object_moved"])
            numbers.append(("object moved", moved, "of the last epoch's episodes"))
        numbers += [
            ("updates/s", _count(row.get("updates_per_second")), updates),
            ("imagined", _count(row.get("imagined_transitions")), "transitions"),
            ("elapsed", self._elapsed(), ""),
        ]
        if not self._done:
            left = _duration(self.seconds_left)
            numbers.append(("left", left, "if the whole budget is spent"))
        return numbers

    @property
    def _has_object(self) -> bool:
        """Rows of a task without an object, such as reach, do not say whether it moved."""
        return "object_moved" in self._row

    def _elapsed(self) -> str:
        return _duration(self._clock() - self._started)


def _bar(done: float, total: float) -> ProgressBar:
    return ProgressBar(total=max(total, 1e-9), completed=min(done, total))


def _percent(share: float | None) -> str:
    return UNKNOWN if share is None or not math.isfinite(share) else f"{share:.0%}"


def _count(number: float | None) -> str:
    return UNKNOWN if number is None or not math.isfinite(number) else f"{number:,.0f}"


def _duration(seconds: float) -> str:
    try:
        return str(datetime.timedelta(seconds=round(seconds)))
    except (OverflowError, ValueError):  # beyond what a timedelta holds; not a number
        return UNKNOWN
