"""Order of writes and syncs, from system calls: data are on the disk before a command is sent."""

from __future__ import annotations

import itertools
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from iher_robot.storage.episode_reader import EpisodeReader
from tests.faults.system_calls import TRACED, Call, read_calls
from tests.served.served_robot import PATIENT, ServedRobot

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.skipif(
        shutil.which("strace") is None, reason="there is no strace here: apt-get install strace"
    ),
]

INDEX, LEDGER, NOTES = "episodes/index.sqlite-wal", "ledger.sqlite-wal", "ledger.lock"
EPISODE = re.compile(r"episodes/episode-\d+\.npz")
_BUDGET_MINUTES = "0.05"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training run of two epochs on a served robot, and the trace of its system calls."""
    folder = tmp_path_factory.mktemp("traced")
    trace, run = folder / "trace.txt", folder / "run"
    with ServedRobot(folder / "memory", *PATIENT) as served:
        command = ["strace", "-f", "--seccomp-bpf", "-qq", "-y", "-s", "2048", "-o", str(trace)]
        command += ["-e", f"trace={TRACED}", sys.executable, "-m", "iher_robot", "train", "--quiet"]
        command += ["--driver", "zenoh", "--connect", served.endpoint, "--task", "reach"]
        command += ["--budget-minutes", _BUDGET_MINUTES, "--until-success", "off"]
        command += ["--set", "evaluation.robot_episodes=1", "--out", str(run)]
        command += ["--set", "learner.schedule.updates_per_step=1"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return run


@pytest.fixture(scope="module")
def calls(run: Path) -> list[Call]:
    """Everything that the run wrote, synced and sent."""
    return read_calls(run.parent / "trace.txt", run)


def positions(calls: Sequence[Call], kind: str, path: str = "") -> list[int]:
    return [i for i, call in enumerate(calls) if call == Call(kind, path)]


def unsynced(calls: Sequence[Call], path: str) -> list[int]:
    """Commands sent while a file was written and not yet synced."""
    waits, found = False, []
    for i, call in enumerate(calls):
        if call.path == path:
            waits = call.kind == "write"
        elif call.kind == "command" and waits:
            found.append(i)
    return found


def written_and_synced(calls: Sequence[Call], path: str, *, at_least: int = 1) -> bool:
    """Whether a file was written in these calls and then synced."""
    kinds = [call.kind for call in calls if call.path == path]
    return kinds.count("write") >= at_least and kinds[-1] == "sync"


def episodes(calls: Sequence[Call]) -> list[tuple[list[int], int]]:
    """Commands of each episode, and the call that renames its file."""
    ends = [i for i, c in enumerate(calls) if c.kind == "rename" and EPISODE.fullmatch(c.path)]
    begins = [0, *ends[:-1]]
    commands = positions(calls, "command")
    return [
        ([i for i in commands if begin < i < end], end)
        for begin, end in zip(begins, ends, strict=True)
    ]


def check_ticks(calls: Sequence[Call]) -> None:
    """Each tick is on the disk, and the next one noted, before the next command leaves."""
    assert unsynced(calls, INDEX) == []
    for commands, _ in episodes(calls):
        for before, after in itertools.pairwise(commands):
            between = calls[before:after]
            assert written_and_synced(between, INDEX), f"the tick after call {before}"
            assert positions(between, "write", NOTES), f"the tick after call {before} is noted"


def check_reservations(calls: Sequence[Call]) -> None:
    """The ticks of an episode are on the ledger before its first command leaves."""
    assert unsynced(calls, LEDGER) == []
    last = 0
    for commands, end in episodes(calls):
        assert written_and_synced(calls[last : commands[0]], LEDGER)
        assert positions(calls[last : commands[0]], "write", NOTES)
        last = end


def check_sealing(calls: Sequence[Call]) -> None:
    """An episode's file is synced and renamed before its journal and its account are closed."""
    for commands, renamed in episodes(calls):
        target = calls[renamed].path
        temporary = target.replace("episode-", ".episode-") + ".tmp"
        sealing = calls[commands[-1] : renamed]
        assert written_and_synced(sealing, temporary)
        first = positions(sealing, "write", temporary)[0]
        assert positions(sealing[first:], "write", INDEX) == []
        named = positions(calls[renamed:], "sync", "episodes")[0] + renamed
        journal = positions(calls[renamed:], "write", INDEX)[0] + renamed
        cleared = positions(calls[journal:], "sync", INDEX)[0] + journal
        settled = positions(calls[commands[-1] :], "write", LEDGER)[0] + commands[-1]
        assert renamed < named < journal < cleared < settled


def check_checkpoints(calls: Sequence[Call]) -> None:
    """A checkpoint is synced before its rename, and the rename before any other call."""
    renames = positions(calls, "rename", "checkpoint.pt")
    assert len(renames) == 2
    before = 0
    for renamed in renames:
        assert written_and_synced(calls[before:renamed], ".checkpoint.pt.tmp")
        after = [call for call in calls[renamed + 1 :] if call.path]
        assert after[0] == Call("sync", ".")
        before = renamed


CHECKS: list[tuple[Callable[[Sequence[Call]], None], Call]] = [
    (check_ticks, Call("sync", INDEX)),
    (check_ticks, Call("write", NOTES)),
    (check_reservations, Call("sync", LEDGER)),
    (check_sealing, Call("sync", "episodes")),
    (check_sealing, Call("sync", "episodes/.episode-000001.npz.tmp")),
    (check_checkpoints, Call("sync", ".checkpoint.pt.tmp")),
    (check_checkpoints, Call("sync", ".")),
]


def test_the_trace_has_every_command(calls: list[Call], run: Path) -> None:
    kept = [stored.episode for stored in EpisodeReader(run / "episodes")]
    sent = [len(commands) for commands, _ in episodes(calls)]
    assert len(sent) == len(kept) == 4
    # Of ticks that a busy machine missed, some had a command and some came too late for one.
    for commands, episode in zip(sent, kept, strict=True):
        assert episode.valid.sum() <= commands <= len(episode.valid)
    assert sum(sent) > 100


def test_each_tick_is_on_the_disk_before_the_next_command(calls: list[Call]) -> None:
    check_ticks(calls)


def test_ticks_are_reserved_on_the_disk_before_an_episode_moves(calls: list[Call]) -> None:
    check_reservations(calls)


def test_an_episode_is_sealed_before_its_journal_is_cleared_and_its_account_settled(
    calls: list[Call],
) -> None:
    check_sealing(calls)


def test_a_checkpoint_is_whole_before_it_replaces_the_last(calls: list[Call]) -> None:
    check_checkpoints(calls)


@pytest.mark.parametrize(("check", "missing"), CHECKS)
def test_a_missing_call_is_found(
    calls: list[Call], check: Callable[[Sequence[Call]], None], missing: Call
) -> None:
    with pytest.raises((AssertionError, IndexError)):
        check([call for call in calls if call != missing])
