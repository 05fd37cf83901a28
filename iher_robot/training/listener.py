"""Run listeners: what shows, plots or forwards the progress of a training run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from iher_robot.evaluation.plot import plot_success
from iher_robot.rollout.observer import EpisodeObserver, Transition
from iher_robot.storage.accounts import Account

Row = Mapping[str, float]
"""Metrics of an epoch by name."""


@dataclass(frozen=True)
class EpisodeReport:
    """A finished episode.

    Attributes:
        account: Account that its ticks were charged to.
        epoch: Epoch that it belongs to, from 1.
        ticks: Control ticks charged.
        success: Whether its last step met the goal.
        aborted: Why it could not go on, empty if it could.
    """

    account: Account
    epoch: int
    ticks: int
    success: bool
    aborted: str


class RunListener:
    """Follows a training run; every hook does nothing unless it is overridden.

    The training loop knows only this class. Hooks are called in the process of the run, so they
    must be quick; an error that one raises ends the run, which can be resumed.
    """

    def announce(self, text: str) -> None:
        """Called with a line for the user that stays."""

    def fault(self, text: str) -> None:
        """Called when the robot is lost, taken or stopped, and when it is back."""
        self.announce(text)

    def resume(self, rows: Sequence[Row]) -> None:
        """Called once at the start of a run that continues.

        Args:
            rows: Metrics of its finished epochs, at least one.
        """

    def phase(self, name: str, done: int, total: int) -> None:
        """Called as the run advances, up to once an update.

        Args:
            name: Such as ``"collect"``, ``"dynamics"``, ``"imagine"``, ``"update"``,
                ``"evaluate"``.
            done: Parts done.
            total: Parts of the phase in this epoch.
        """

    def minutes(self, used: float) -> None:
        """Called when robot minutes of the budget were spent.

        Args:
            used: Robot minutes spent in all.
        """

    def tick(self, transition: Transition) -> None:
        """Called after each control tick of the run's robot; simulator processes report none."""

    def episode(self, report: EpisodeReport) -> None:
        """Called after each episode of the run's robot."""

    def epoch(self, row: Row) -> None:
        """Called after each epoch, when its metrics, policy and checkpoint are on the disk.

        Args:
            row: Its metrics; ``success`` is among them where it was evaluated.
        """

    def question(self) -> AbstractContextManager[object]:
        """Return a context in which the terminal is left to a question to the user."""
        return nullcontext()


class RunListeners(RunListener):
    """Several listeners as one; each hook calls theirs in turn.

    Args:
        listeners: The listeners, in the order in which they are called.
    """

    def __init__(self, listeners: Sequence[RunListener]) -> None:
        self._listeners = tuple(listeners)

    def announce(self, text: str) -> None:
        """Forward the line."""
        self._each(lambda listener: listener.announce(text))

    def fault(self, text: str) -> None:
        """Forward the line."""
        self._each(lambda listener: listener.fault(text))

    def resume(self, rows: Sequence[Row]) -> None:
        """Forward the metrics."""
        self._each(lambda listener: listener.resume(rows))

    def phase(self, name: str, done: int, total: int) -> None:
        """Forward the phase."""
        self._each(lambda listener: listener.phase(name, done, total))

    def minutes(self, used: float) -> None:
        """Forward the robot minutes."""
        self._each(lambda listener: listener.minutes(used))

    def tick(self, transition: Transition) -> None:
        """Forward the tick."""
        self._each(lambda listener: listener.tick(transition))

    def episode(self, report: EpisodeReport) -> None:
        """Forward the episode."""
        self._each(lambda listener: listener.episode(report))

    def epoch(self, row: Row) -> None:
        """Forward the metrics."""
        self._each(lambda listener: listener.epoch(row))

    @contextmanager
    def question(self) -> Iterator[None]:
        """Return a context in which every listener leaves the terminal alone."""
        with ExitStack() as stack:
            self._each(lambda listener: stack.enter_context(listener.question()))
            yield

    def _each(self, call: Callable[[RunListener], object]) -> None:
        for listener in self._listeners:
            call(listener)


class TickForwarder(EpisodeObserver):
    """Forwards the ticks of episodes to a run listener.

    Args:
        listener: The listener.
    """

    def __init__(self, listener: RunListener) -> None:
        self._listener = listener

    def after_tick(self, transition: Transition) -> None:
        """Forward a tick."""
        self._listener.tick(transition)


class SuccessPlot(RunListener):
    """Plots success against robot minutes, again after each epoch.

    Args:
        path: Image file.
        label: Label of the curve.
        title: Title of the plot.
        subtitle: Line under the title.
        budget_minutes: Robot minutes granted.
    """

    def __init__(
        self, path: Path, *, label: str, title: str, subtitle: str, budget_minutes: float
    ) -> None:
        self._path = path
        self._label = label
        self._title = title
        self._subtitle = subtitle
        self._budget_minutes = budget_minutes
        self._rows: list[Row] = []

    def resume(self, rows: Sequence[Row]) -> None:
        """Take over the metrics of earlier epochs."""
        self._rows = list(rows)

    def epoch(self, row: Row) -> None:
        """Plot."""
        self._rows.append(row)
        plot_success(
            {self._label: self._rows},
            self._path,
            title=self._title,
            subtitle=self._subtitle,
            budget_minutes=self._budget_minutes,
        )
