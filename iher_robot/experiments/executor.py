"""Who runs the cells of an experiment."""

from __future__ import annotations

import subprocess
import threading
from abc import abstractmethod
from collections.abc import Collection
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress

from drivers.closing import Closing
from iher_robot.experiments.cell_process import Order, Outcome, run_order

END_S = 60.0
"""How long a cell that is to end may take to settle its accounts."""


class Executor(Closing):
    """Runs cells side by side, as many as there are cores for.

    ``close`` ends those that still run, in order: they can be resumed.

    Attributes:
        title: Who it is, in words.
        slots: Cells that it runs side by side.
    """

    title: str
    slots: int

    @property
    @abstractmethod
    def running(self) -> Collection[str]:
        """Names of the cells that have begun, as far as that is known here."""

    @abstractmethod
    def submit(self, order: Order) -> Future[Outcome]:
        """Hand over a cell; it begins when a core is free."""


class LocalExecutor(Executor):
    """Cells as processes of this machine.

    Args:
        workers: How many run side by side.
        title: That, in words.
    """

    def __init__(self, workers: int, title: str = "") -> None:
        self.title = title or f"{workers} at a time on this machine"
        self.slots = workers
        self._ending = threading.Event()
        self._mutex = threading.Lock()
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        # Its threads live until it is shut down: a process ends with the thread that started it.
        self._threads = ThreadPoolExecutor(workers, thread_name_prefix="cell")

    @property
    def running(self) -> Collection[str]:
        """Names of the cells that run."""
        with self._mutex:
            return set(self._running)

    def submit(self, order: Order) -> Future[Outcome]:
        """Hand over a cell; it begins when a core is free."""
        return self._threads.submit(self._run, order)

    def close(self) -> None:
        """End the cells in order, or by force if they take too long; twice does nothing."""
        with self._mutex:
            self._ending.set()
            running = list(self._running.values())
        for process in running:
            process.terminate()
        try:
            for process in running:
                with suppress(subprocess.TimeoutExpired):
                    process.wait(END_S)
        finally:  # a second Ctrl-C, too
            for process in running:
                process.kill()
            self._threads.shutdown(wait=True, cancel_futures=True)

    def _run(self, order: Order) -> Outcome:
        def begin(process: subprocess.Popen[bytes]) -> None:
            with self._mutex:
                self._running[order.name] = process
                if self._ending.is_set():
                    process.terminate()

        try:
            return run_order(order, begin, self._ending.is_set)
        finally:
            with self._mutex:
                self._running.pop(order.name, None)
