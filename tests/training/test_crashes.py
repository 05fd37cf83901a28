"""A run that is killed at any point loses nothing that was written, and counts every tick."""

from __future__ import annotations

import math
import shutil
import signal
from pathlib import Path

import pytest

from iher_robot.config.options import load_config
from iher_robot.storage.accounts import read_accounts
from iher_robot.storage.episode_reader import EpisodeReader
from iher_robot.storage.episode_store import CUT_OFF, EpisodeStore
from iher_robot.storage.ledger import Ledger
from iher_robot.storage.run_directory import RunDirectory
from iher_robot.training.recovery import restore
from iher_robot.training.train import resume
from tests.forked import run_forked
from tests.small_runs import metrics, motion_ticks, stored_ticks
from tests.storage.test_episode_store import make_stored, record

BUDGET_TICKS = 150
CONFIG = load_config("reach", preset="paper")
KILLED = """
import os, signal, sys
from pathlib import Path
from tests.forked import run_forked
from tests.small_runs import run

module, owner, name, call = sys.argv[2].split()
target = __import__(module, fromlist=[owner])
if owner != "-":
    target = getattr(target, owner)
original, calls = getattr(target, name), 0

def killed(*args, **options):
    global calls
    calls += 1
    if calls == int(call):
        os.kill(os.getpid(), signal.SIGKILL)
    return original(*args, **options)

setattr(target, name, killed)
run(Path(sys.argv[1]), 0.1001)
"""


def kill_at(out: Path, place: str, program: str = KILLED) -> None:
    """Run until a function is called for the given time, and kill the process there."""
    done = run_forked(program, str(out), place)
    assert done.returncode == -signal.SIGKILL, done.stderr


# What is called when, how many ticks have begun by then, and how many are in the store.
PLACES = {
    "iher_robot.env.goal_env GoalRobotEnv _begin_episode 2": (50, 50),
    "iher_robot.env.goal_env GoalRobotEnv _run_tick 68": (68, 67),
    "iher_robot.storage.episode_store - write_atomically 2": (100, 100),
    "iher_robot.storage.episode_journal EpisodeIndex add 2": (100, 100),
    "iher_robot.storage.ledger Ledger settle 4": (100, 100),
    "iher_robot.training.loop - save_checkpoint 1": (100, 100),
    "iher_robot.storage.files.torch_file - write_atomically 3": (150, 150),
}


@pytest.mark.parametrize("place", PLACES)
def test_a_kill_counts_what_had_begun_and_keeps_what_was_written(
    tmp_path: Path, place: str
) -> None:
    out = tmp_path / "run"
    begun, recorded = PLACES[place]
    kill_at(out, place)
    assert motion_ticks(out) == begun

    resume(out, display=False)

    assert motion_ticks(out) == BUDGET_TICKS
    assert stored_ticks(out) == BUDGET_TICKS - (begun - recorded)
    with EpisodeReader(out / "episodes") as reader:
        ended = [stored.ended for stored in reader]
    assert ended.count(CUT_OFF) <= 1
    assert len(set(ended) - {"done", CUT_OFF}) == 0
    assert [row["epoch"] for row in metrics(out)] == list(range(1, len(metrics(out)) + 1))
    assert metrics(out)[-1]["robot_minutes"] * 1500 == pytest.approx(BUDGET_TICKS)


def test_a_crash_of_the_machine_in_a_simulated_episode_counts_all_that_was_reserved(
    tmp_path: Path,
) -> None:
    out = tmp_path / "run"
    kill_at(out, "iher_robot.env.goal_env GoalRobotEnv _run_tick 68")
    forget_notes(out)
    assert motion_ticks(out) == 100
    resume(out, display=False)
    assert motion_ticks(out) == BUDGET_TICKS
    assert stored_ticks(out) == 67 + 50


def test_a_run_that_is_killed_in_its_last_tick_can_be_ended(tmp_path: Path) -> None:
    """Its budget is spent, and its last epoch was not one to evaluate."""
    out = tmp_path / "run"
    program = KILLED.replace("0.1001)", "0.0674, 'evaluation.every_epochs=2')")
    kill_at(out, "iher_robot.env.goal_env GoalRobotEnv _run_tick 101", program)
    assert motion_ticks(out) == 101
    result = resume(out, display=False)
    assert math.isnan(result.success_rate)
    assert result.final is not None


def test_a_copy_counts_what_was_reserved(tmp_path: Path) -> None:
    out = tmp_path / "run"
    kill_at(out, "iher_robot.env.goal_env GoalRobotEnv _run_tick 68")
    copy = shutil.copytree(out, tmp_path / "copy")
    assert (motion_ticks(out), motion_ticks(copy)) == (68, 100)
    resume(copy, display=False)
    assert motion_ticks(copy) == BUDGET_TICKS
    assert motion_ticks(out) == 68


def forget_notes(out: Path) -> None:
    """As when the machine was started again: what processes noted counts for nothing."""
    (out / "ledger.lock").unlink()
    (out / "episodes" / "store.lock").unlink()


@pytest.mark.parametrize(
    ("durable", "count", "ended", "charged"),
    [(True, 4, None, 5), (True, 6, "done", 6), (True, 6, "lost", 50), (False, 4, None, 50)],
)
def test_a_durable_journal_says_after_a_crash_of_the_machine_what_had_begun(
    tmp_path: Path, durable: bool, count: int, ended: str | None, charged: int
) -> None:
    directory = RunDirectory.create(tmp_path / "run", "seed: 0\n")
    ledger = Ledger(directory.ledger_path)
    store = EpisodeStore(directory.episodes_path, durable_ticks=durable)
    with ledger.reserve("motion", 50) as entry:
        record(store, make_stored(3, epoch=1, entry=entry.number), count)
        if ended is not None:
            store.seal(ended)
    for part in (ledger._database, ledger._lock, store._index, store._lock):
        part.close()
    forget_notes(directory.path)
    with (
        Ledger(directory.ledger_path) as ledger,
        EpisodeStore(directory.episodes_path, durable_ticks=durable) as store,
    ):
        assert ledger.spent_ticks("motion") == 50
        restore(directory, CONFIG, store, ledger)
        assert ledger.spent_ticks("motion") == charged
    with (
        Ledger(directory.ledger_path) as ledger,
        EpisodeStore(directory.episodes_path, durable_ticks=durable) as store,
    ):
        restore(directory, CONFIG, store, ledger)
        assert ledger.spent_ticks("motion") == charged, "nothing is given back later"
    assert read_accounts(directory.ledger_path).spent["motion"] == charged
