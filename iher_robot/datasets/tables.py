"""Tables of runs, episodes and robot time."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from iher_robot.datasets.spending import Spending
from iher_robot.datasets.summary import EpisodeGroup, EpisodeReport, RunLine, RunReport
from iher_robot.storage.robot_time import RobotTime

_FILE_WIDTH = 240
_LEFT_ALIGNED = {"run", "task", "robot", "algorithm", "robot time", "last change", "account"}


def print_tables(shown: RenderableType) -> None:
    """Print in the width of the terminal; in a file every row stays one line."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=_FILE_WIDTH)
    console.print(shown)


def runs_table(lines: Iterable[RunLine]) -> RenderableType:
    """One row for each run; problems of damaged ones below."""
    columns = "run task robot algorithm seed episodes".split()
    table = _table(*columns, "robot time", "success", "last change")
    problems = []
    for line in lines:
        if line.problem:
            problems.append(Text(f"{line.path} is damaged: {line.problem}"))
            cells = ["damaged", "", "", "", "", "", ""]
        else:
            success = f"{line.successes / line.episodes:.0%}" if line.episodes else ""
            cells = [line.task, line.robot, f"{line.algo}, {line.preset}", str(line.seed)]
            cells += [str(line.episodes), line.robot_time, success]
        _add(table, str(line.path), *cells, f"{line.last_change:%Y-%m-%d %H:%M}")
    return Group(table, *problems)


def run_table(report: RunReport) -> RenderableType:
    """Facts of a run, and one row for each account and epoch."""
    facts = Table.grid(padding=(0, 2))
    for name, fact in report.facts.items():
        _add(facts, name, fact)
    table = _table("account", "epoch", *"episodes ticks invalid clipped return success".split())
    for group in report.groups:
        _add(table, group.account, str(group.epoch), *_counts([group]))
    if len(report.groups) > 1:
        table.add_section()
        _add(table, "all", "", *_counts(report.groups))
    return Group(Text(report.title), facts, table)


def episode_table(report: EpisodeReport) -> RenderableType:
    """One row for each tick."""
    stored, episode = report.stored, report.stored.episode
    columns = ("tick", "seq", "valid", "requested", "applied", "achieved goal, m", "distance, m")
    table = _table(*columns)
    for tick in range(len(episode)):
        _add(
            table,
            str(tick),
            str(stored.seqs[tick]),
            "yes" if episode.valid[tick] else "no",
            _numbers(episode.requested_actions[tick]),
            _numbers(episode.actions[tick]),
            _numbers(report.achieved[tick]),
            f"{report.distance[tick]:.3f}",
        )
    return Group(Text(report.title), table)


def spending_table(spending: Spending) -> RenderableType:
    """One row for each account, and what is left of the budget."""
    table = _table("account", "ticks", "robot minutes")
    _add_times(table, spending.spent.items())
    if spending.budget is not None and spending.left is not None:
        table.add_section()
        times = {"motion budget": spending.budget, "left": spending.left}
        if spending.granted is not None and spending.granted.ticks:
            times["granted later"] = spending.granted
        _add_times(table, times.items())
    return Group(Text(spending.owner), table)


def _counts(groups: Iterable[EpisodeGroup]) -> list[str]:
    groups = list(groups)
    episodes = sum(group.episodes for group in groups)
    total_return = sum(group.mean_return * group.episodes for group in groups)
    return [
        str(episodes),
        str(sum(group.ticks for group in groups)),
        str(sum(group.invalid_ticks for group in groups)),
        str(sum(group.clipped_ticks for group in groups)),
        f"{total_return / episodes:.1f}",
        f"{sum(group.successes for group in groups) / episodes:.0%}",
    ]


def _add_times(table: Table, times: Iterable[tuple[str, RobotTime]]) -> None:
    for name, time in times:
        _add(table, name, f"{time.ticks:,}", f"{time.minutes:.2f}")


def _numbers(values: NDArray[np.floating]) -> str:
    return " ".join(f"{value:+.3f}" for value in values)


def _table(*columns: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD)
    for name in columns:
        table.add_column(
            name, justify="left" if name in _LEFT_ALIGNED else "right", overflow="fold"
        )
    return table


def _add(table: Table, *cells: str) -> None:
    """Add a row without markup: names of folders may look like rich's."""
    table.add_row(*map(Text, cells))
