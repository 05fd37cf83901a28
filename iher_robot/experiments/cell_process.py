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

from iher_robot.storage.files.atomic import write_atomically
from iher_robot.storage.files.lock import LockFile, wait_for_lock
from iher_robot.storage.run_directory import RunDirectory
from iher_robot.storage.run_result import read_result

# The kernel sends SIGTERM when the thread that started the process ends, for whatever reason; the
# run then ends in order. -P and sys.path: see training/learners/asynchronous.py.
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
"""Source of the process."""

# A cell has one core; thread pools of libraries would use more.
_ONE_CORE = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}

Ending = Literal["finished", "interrupted", "failed"]
_INTERRUPTED = (130, 143, -signal.SIGTERM, -signal.SIGINT)


@dataclass(frozen=True)
class CellJob:
    """A cell to run, as executors receive it.

    Attributes:
        name: Name of the cell.
        config: Its settings, the text of a config file.
        config_path: Where that file is written; a new run reads it.
        run: Folder of its run.
        log: File for its output.
    """

    name: str
    config: str
    config_path: Path
    run: Path
    log: Path

    def absolute(self) -> CellJob:
        """The same job with absolute paths, for a process in another working directory."""
        return dataclasses.replace(
            self,
            config_path=self.config_path.absolute(),
            run=self.run.absolute(),
            log=self.log.absolute(),
        )

    def arguments(self) -> list[str]:
        """Arguments of ``iher-robot``: start a new run, or resume an interrupted one."""
        config = RunDirectory(self.run).config_path
        if config.exists() and config.stat().st_size:
            return ["train", "--resume", str(self.run), "--quiet"]
        return ["train", "--config", str(self.config_path), "--out", str(self.run), "--quiet"]


@dataclass(frozen=True)
class Outcome:
    """How the process of a cell ended.

    Attributes:
        name: Name of the cell.
        ending: Final state of the cell.
        reason: Why it did not finish; empty if it did.
        lines: Last lines of its output.
        node: Host name of the node that ran it, empty for this machine.
        files: Small files of a run that is stored on another machine, by name.
    """

    name: str
    ending: Ending
    reason: str = ""
    lines: tuple[str, ...] = ()
    node: str = ""
    files: dict[str, bytes] = field(default_factory=dict)


def run_cell(
    job: CellJob, on_start: Callable[[subprocess.Popen[bytes]], None], cancelled: Callable[[], bool]
) -> Outcome:
    """Run a cell to its end in a child process, from its last epoch if it was interrupted.

    Args:
        job: The cell.
        on_start: Called with the process once it has started.
        cancelled: Whether the cell should not be started any more.

    Raises:
        UserError: An earlier process of the cell still runs, or its result is damaged.
    """
    job.log.parent.mkdir(parents=True, exist_ok=True)
    with hold_cell(job.log.with_suffix(".lock"), cancelled) as lock:
        if read_result(RunDirectory(job.run).result_path) is not None:
            return Outcome(job.name, "finished")
        if cancelled():
            return Outcome(job.name, "interrupted", "interrupted before it began")
        job.config_path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(job.config_path, lambda file: file.write(job.config.encode()))
        with job.log.open("ab") as log:
            process = _start(job.arguments(), lock, log)
    on_start(process)
    code = process.wait()
    lines = tuple(_last_lines(job.log))
    if code == 0 and read_result(RunDirectory(job.run).result_path) is not None:
        return Outcome(job.name, "finished", lines=lines)
    ending: Ending = "interrupted" if code in _INTERRUPTED else "failed"
    return Outcome(job.name, ending, _reason(code), lines)


def hold_cell(path: Path, cancelled: Callable[[], bool], patience_s: float = 60.0) -> LockFile:
    """Hold a cell, once an earlier process of it has ended.

    Args:
        path: Its lock.
        cancelled: Whether to stop waiting.
        patience_s: Longest wait for that process, s.

    Raises:
        FileHeld: The process still runs.
    """
    return wait_for_lock(
        path, f"an earlier process of {path.stem} still runs", patience_s, cancelled
    )


def _start(arguments: list[str], lock: LockFile, log: BinaryIO) -> subprocess.Popen[bytes]:
    """Start the process; it inherits the lock and holds it as long as it lives."""
    now = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
    log.write(f"== {now} iher-robot {shlex.join(arguments)}\n".encode())
    log.flush()
    head = [sys.executable, "-P", "-c", PROGRAM, json.dumps(sys.path), str(os.getpid())]
    return subprocess.Popen(
        [*head, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=subprocess.STDOUT,
        env={**os.environ, **_ONE_CORE},
        pass_fds=(lock.fileno(),),
        # Ctrl-C reaches the experiment alone, which then ends its cells in order.
        start_new_session=True,
    )


def _last_lines(path: Path, count: int = 5) -> list[str]:
    """Last lines of a log that are not blank."""
    try:
        with path.open("rb") as file:
            file.seek(max(0, os.fstat(file.fileno()).st_size - 8192))
            text = file.read().decode(errors="replace")
    except OSError:
        return []
    return [line for line in text.splitlines() if line.strip()][-count:]


def _reason(code: int) -> str:
    if code < 0:
        return f"killed by {signal.Signals(-code).name}"
    if code in _INTERRUPTED:
        return "interrupted"
    return f"exit code {code}"
