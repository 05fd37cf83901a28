"""The process of a cell: ``iher-robot train``, tied to the process that started it."""

from __future__ import annotations

import dataclasses
import datetime
import json
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, Literal

from iher_robot.experiments.folder import hold_cell, tail
from iher_robot.storage.files.atomic import write_atomically
from iher_robot.storage.files.lock import LockFile
from iher_robot.storage.run_directory import RunDirectory
from iher_robot.storage.run_result import read_result

# The kernel sends SIGTERM when the thread that started it is gone, however it went; the run then
# ends in order. -P and sys.path: see learner_process.py.
PROGRAM = """
import ctypes, json, os, signal, sys
PR_SET_PDEATHSIG = 1
ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
if os.getppid() != int(sys.argv[2]):
    sys.exit("the experiment is gone")
sys.path[:] = json.loads(sys.argv[1])
sys.argv[:] = ["iher-robot", *sys.argv[3:]]
from iher_robot.cli.app import main
main()
"""
"""What the process runs."""

# A cell has one core; libraries that start threads of their own would take others.
_ONE_CORE = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}

Ending = Literal["finished", "interrupted", "failed"]
_INTERRUPTED = (130, 143, -signal.SIGTERM, -signal.SIGINT)


@dataclass(frozen=True)
class Order:
    """A cell to be run, by whoever can.

    Attributes:
        name: Name of the cell.
        config: Its settings, the text of a config file.
        run: Folder of its run.
        log: Where to print to.
    """

    name: str
    config: str
    run: Path
    log: Path

    def absolute(self) -> Order:
        """The same for a process in another working folder."""
        return dataclasses.replace(self, run=self.run.absolute(), log=self.log.absolute())

    @property
    def config_path(self) -> Path:
        """The config file that a new run begins with, beside the log."""
        return self.log.with_suffix(".yaml")

    def words(self) -> list[str]:
        """The words after ``iher-robot``: start a new run, or resume an interrupted one."""
        config = RunDirectory(self.run).config_path
        if config.exists() and config.stat().st_size:
            return ["train", "--resume", str(self.run), "--quiet"]
        return ["train", "--config", str(self.config_path), "--out", str(self.run), "--quiet"]


@dataclass(frozen=True)
class Outcome:
    """How the process of a cell ended.

    Attributes:
        name: Name of the cell.
        ending: What became of the cell.
        reason: Why, in words, if it did not finish.
        lines: The last lines that it printed.
        place: Where it ran, empty for this machine.
        files: Small files of a run whose folder lies elsewhere, by name.
    """

    name: str
    ending: Ending
    reason: str = ""
    lines: tuple[str, ...] = ()
    place: str = ""
    files: dict[str, bytes] = field(default_factory=dict)


def run_order(
    order: Order, begin: Callable[[subprocess.Popen[bytes]], None], unwanted: Callable[[], bool]
) -> Outcome:
    """Run a cell to its end, in a process of its own; from its last epoch if it was interrupted.

    Args:
        order: The cell.
        begin: Called with its process, once it is there.
        unwanted: Whether nobody wants the cell any more.

    Raises:
        UserError: An earlier process of the cell goes on, or its result is damaged.
    """
    order.log.parent.mkdir(parents=True, exist_ok=True)
    with hold_cell(order.log.with_suffix(".lock"), unwanted) as lock:
        if read_result(RunDirectory(order.run).result_path) is not None:
            return Outcome(order.name, "finished")
        if unwanted():
            return Outcome(order.name, "interrupted", "interrupted before it began")
        write_atomically(order.config_path, lambda file: file.write(order.config.encode()))
        with order.log.open("ab") as log:
            process = _start(order.words(), lock, log)
    begin(process)
    code = process.wait()
    lines = tuple(tail(order.log))
    if code == 0 and read_result(RunDirectory(order.run).result_path) is not None:
        return Outcome(order.name, "finished", lines=lines)
    ending: Ending = "interrupted" if code in _INTERRUPTED else "failed"
    return Outcome(order.name, ending, _reason(code), lines)


def _start(words: list[str], lock: LockFile, log: BinaryIO) -> subprocess.Popen[bytes]:
    """Start it; the lock is its own from then on, for as long as it lives."""
    now = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
    log.write(f"== {now} iher-robot {shlex.join(words)}\n".encode())
    log.flush()
    head = [sys.executable, "-P", "-c", PROGRAM, json.dumps(sys.path), str(os.getpid())]
    return subprocess.Popen(
        [*head, *words],
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=subprocess.STDOUT,
        env={**os.environ, **_ONE_CORE},
        pass_fds=(lock.fileno(),),
        # A Ctrl-C is for the experiment, which ends its cells in order.
        start_new_session=True,
    )


def _reason(code: int) -> str:
    if code < 0:
        return f"killed by {signal.Signals(-code).name}"
    if code in _INTERRUPTED:
        return "interrupted"
    return f"exit code {code}"
