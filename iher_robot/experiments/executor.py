"""Executor: the interface that runs cells, and its implementation on this machine."""

from __future__ import annotations

import subprocess
import threading
from abc import abstractmethod
from collections.abc import Collection
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress

from drivers.closing import Closing
from iher_robot.experiments.cell_process import CellJob, Outcome, run_cell

SHUTDOWN_S = 60.0
"""Time for a cell to end in order once it is interrupted, s."""


class Executor(Closing):
    """Runs cells in parallel, one per core.

    ``close`` interrupts the cells that still run; they can be resumed.

    Attributes:
        title: Description for the user.
        slots: Number of cells that run in parallel.
    """

    title: str
    slots: int

    @property
    @abstractmethod
    def running(self) -> Collection[str]:
        """Names of the cells that have started, as far as this process knows."""

    @abstractmethod
    def submit(self, job: CellJob) -> Future[Outcome]:
        """Queue a cell; it starts when a core is free."""


class LocalExecutor(Executor):
    """Runs cells as processes of this machine.

    Args:
        workers: Number of cells that run in parallel.
        title: Description for the user.
    """

    def __init__(self, workers: int, title: str = "") -> None:
        self.title = title or f"{workers} at a time on this machine"
        self.slots = workers
        self._ending = threading.Event()
        self._mutex = threading.Lock()
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        # The threads live until shutdown: a process ends with the thread that started it.
        self._threads = ThreadPoolExecutor(workers, thread_name_prefix="cell")

    @property
    def running(self) -> Collection[str]:
        """Names of the cells that run."""
        with self._mutex:
            return set(self._running)

    def submit(self, job: CellJob) -> Future[Outcome]:
        """Queue a cell; it starts when a core is free."""
        return self._threads.submit(self._run, job)

    def close(self) -> None:
        """End the cells in order, then by force after `SHUTDOWN_S`; idempotent."""
        with self._mutex:
            self._ending.set()
            running = list(self._running.values())
        for process in running:
            process.terminate()
        try:
            for process in running:
                with suppress(subprocess.TimeoutExpired):
                    process.wait(SHUTDOWN_S)
        finally:  # after a second Ctrl-C too
            for process in running:
                process.kill()
            self._threads.shutdown(wait=True, cancel_futures=True)

    def _run(self, job: CellJob) -> Outcome:
        def on_start(process: subprocess.Popen[bytes]) -> None:
            with self._mutex:
                self._running[job.name] = process
                if self._ending.is_set():
                    process.terminate()

        try:
            return run_cell(job, on_start, self._ending.is_set)
        finally:
            with self._mutex:
                self._running.pop(job.name, None)
