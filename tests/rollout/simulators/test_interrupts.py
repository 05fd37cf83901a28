"""Interrupts at many points of a run in several simulators, which here answer at once."""

from __future__ import annotations

import sys
from collections import Counter
from multiprocessing import Pipe
from multiprocessing.connection import wait
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from iher_robot.learning.episode import Episode
from iher_robot.rollout.simulators import pool as pool_module
from iher_robot.rollout.simulators.child_process import ChildProcess
from iher_robot.rollout.simulators.collect import SimulatedEpisodes
from iher_robot.rollout.simulators.messages import pack_episodes, receive_message, send_message
from iher_robot.rollout.simulators.pool import SimulatorPool
from iher_robot.storage.budget import Budget
from iher_robot.storage.episode_store import EpisodeStore
from iher_robot.storage.ledger import Ledger
from iher_robot.storage.robot_time import RobotTime

EPISODE_TICKS = 5
BUDGET_TICKS = 17  # three episodes and a part of one
MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None  # no disk is waited for
TRACED = tuple(
    f"iher_robot/{name}.py"
    for name in (
        "storage/episode_journal storage/episode_reader storage/episode_store "
        "rollout/simulators/child_process rollout/simulators/collect rollout/simulators/pool"
    ).split()
)
Line = tuple[str, int]


class Interrupter:
    """Notes the lines of a block that are run, and interrupts before one of them.

    Args:
        line: Which one, None for none.
        nth: The how manieth time.
    """

    def __init__(self, line: Line | None = None, nth: int = 0) -> None:
        self.lines: Counter[Line] = Counter()
        self._line = line
        self._nth = nth

    def __enter__(self) -> Interrupter:
        self._before = sys.gettrace()
        sys.settrace(self._call)
        return self

    def __exit__(self, *_: object) -> None:
        sys.settrace(self._before)

    def _call(self, frame: FrameType, event: str, _: object) -> Any:
        return self._trace if frame.f_code.co_filename.endswith(TRACED) else None

    def _trace(self, frame: FrameType, event: str, _: object) -> Any:
        if event == "line":
            line = (frame.f_code.co_filename, frame.f_lineno)
            self.lines[line] += 1
            if line == self._line and self.lines[line] == self._nth:
                sys.settrace(None)
                raise KeyboardInterrupt
        return self._trace


@pytest.fixture
def simulators(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Those that are started, each in this process."""
    started: list[Any] = []
    send = ChildProcess.send

    def start(self: Any) -> None:
        started.append(self)
        self._connection, self.its = Pipe()

    def answer(self: Any, message: Any) -> None:
        send(self, message)
        told = receive_message(self.its)
        if told["kind"] == "begin":
            send_message(self.its, {"kind": "ready", "opened_ticks": 1})
        elif told["kind"] == "episode":
            send_message(self.its, whole_episode(told["ticks"]))

    def wait_for_no_one(connections: Any) -> Any:
        return wait(connections, 0.0) or pytest.fail("it would wait for ever")

    monkeypatch.setattr(ChildProcess, "start", start)
    monkeypatch.setattr(ChildProcess, "send", answer)
    monkeypatch.setattr(pool_module, "wait", wait_for_no_one)
    monkeypatch.setattr(pool_module, "take_snapshot", lambda _: {})
    return started


def whole_episode(ticks: int) -> dict[str, Any]:
    zeros = np.zeros((ticks, 1))
    data = Episode(np.zeros((ticks + 1, 1)), zeros, zeros, np.ones(ticks, bool), np.zeros(1))
    return {
        "kind": "episode",
        "ticks": ticks,
        "reset_ticks": 1,
        "success": False,
        "aborted": "",
        "policy_source": 0,
        "ended": "done",
        "failure": "",
        "steps": torch.arange(1, ticks + 1),
        "elapsed": torch.ones(ticks, dtype=torch.int64),
        "episodes": pack_episodes([data]),
    }


def collect(folder: Path, interrupter: Interrupter) -> int:
    """Spend the budget of a run, or what is left of it; returns ticks that were lost before."""
    config: Any = SimpleNamespace(simulators=2, model_dump_json=lambda: "{}")
    learner: Any = None
    with Ledger(folder / "ledger.sqlite") as ledger, EpisodeStore(folder / "episodes") as store:
        budget = Budget(ledger, RobotTime(BUDGET_TICKS, 0.04))
        lost = lost_ticks(store, budget)
        with (
            SimulatorPool(config, EPISODE_TICKS) as pool,
            SimulatedEpisodes(pool, budget, store, lambda number: number) as episodes,
            interrupter,
        ):
            while budget.remaining.ticks:
                for _ in episodes.run(learner, epoch=1, first=len(store), count=3):
                    pass
        assert lost_ticks(store, budget) == lost
        assert not budget.remaining.ticks
    return lost


def lost_ticks(store: EpisodeStore, budget: Budget) -> int:
    """Check what is stored and counted; returns ticks that are counted alone."""
    kept = list(store)
    assert [one.seed for one in kept] == list(range(len(kept)))
    lost = budget.spent.ticks - sum(len(one.episode) for one in kept)
    assert 0 <= lost <= budget.spent.ticks <= BUDGET_TICKS
    return lost


def test_an_interrupt_before_any_line_comes_through_and_the_run_goes_on(
    simulators: list[Any],
) -> None:
    whole = Interrupter()
    with TemporaryDirectory(dir=MEMORY) as folder:
        assert collect(Path(folder), whole) == 0
    assert len(whole.lines) > 100
    lost = Counter[int]()
    for line, count in whole.lines.items():
        simulators.clear()
        with TemporaryDirectory(dir=MEMORY) as folder:
            try:
                with pytest.raises(KeyboardInterrupt):
                    collect(Path(folder), Interrupter(line, -(-count // 2)))
                assert not any(simulator.is_open for simulator in simulators)
                ticks = collect(Path(folder), Interrupter())
                lost[ticks] += 1
            except BaseException as error:
                error.add_note(f"interrupted at {line[0]}:{line[1]}")
                raise
    assert set(lost) <= {0, EPISODE_TICKS, 2 * EPISODE_TICKS}
    assert lost[0] > lost.total() / 2, "an episode is lost only while it begins or is taken over"
