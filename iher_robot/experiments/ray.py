"""Cells as tasks of a Ray cluster."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
from collections.abc import Callable, Collection
from concurrent.futures import Future, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from iher_robot.errors import UserError
from iher_robot.experiments.cell_process import Order, Outcome, run_order
from iher_robot.experiments.executor import END_S, Executor
from iher_robot.storage.run_directory import RunDirectory


@dataclass(frozen=True)
class Place:
    """Where the cells of an experiment belong.

    Attributes:
        lock: A file in the experiment's folder.
        digest: SHA-256 of its content, which no other experiment has.
        ship: Whether cells run elsewhere even where it is seen.
    """

    lock: Path
    digest: str
    ship: bool

    @property
    def is_seen(self) -> bool:
        """Whether this node sees the experiment's folder."""
        try:
            return hashlib.sha256(self.lock.read_bytes()).hexdigest() == self.digest
        except OSError:
            return False


def run_on_node(order: Order, place: Place) -> Outcome:
    """Run a cell, in the experiment's folder where this node sees it.

    Args:
        order: The cell, with absolute paths.
        place: Where it belongs.

    Returns:
        How it ended, and small files of its run if that is elsewhere.
    """
    node = socket.gethostname()
    if place.is_seen and not place.ship:
        return dataclasses.replace(_run(order), place=node)
    # The same for each try, so that one on this node goes on.
    scratch = Path(tempfile.gettempdir()) / f"iher-robot-{place.digest[:16]}"
    there = dataclasses.replace(
        order, run=scratch / "cells" / order.name, log=scratch / "logs" / f"{order.name}.log"
    )
    outcome = _run(there)
    files = {"log": there.log.read_bytes()} if there.log.exists() else {}
    if outcome.ending == "finished":
        files |= _small_files(there.run)
        shutil.rmtree(there.run)
    return dataclasses.replace(outcome, place=node, files=files)


def _run(order: Order) -> Outcome:
    processes: list[subprocess.Popen[bytes]] = []
    try:
        return run_order(order, processes.append, lambda: False)
    except KeyboardInterrupt:  # the experiment was interrupted: Ray cancels the task
        for process in processes:
            process.terminate()
            process.wait(END_S)
        return Outcome(order.name, "interrupted", "interrupted")


def _small_files(path: Path) -> dict[str, bytes]:
    """What tables and reports need, and the policy; episodes and checkpoint stay behind."""
    run = RunDirectory(path)
    kept = (
        run.config_path,
        run.provenance_path,
        run.metrics_path,
        run.policy_path,
        run.plot_path,
        run.result_path,
    )
    return {file.name: file.read_bytes() for file in kept}


NEEDED = "pip install 'iher-robot[ray]'"

_CONNECT_S = 10.0

RETRIES = 10
"""How often a cell is given to another node after its own was lost."""


class RayExecutor(Executor):
    """Cells as tasks that take one core each, on whichever node of a cluster has one.

    A node that sees the folder of the experiment at the same path runs a cell there: when a node
    is lost, another one goes on from the last epoch, and so does a later experiment. A node that
    does not see it runs the cell on a disk of its own and ships small files of it back once it
    has finished: when that node is lost, its cells begin anew.

    Args:
        lock: File in the experiment's folder by which a node tells whether it sees it.
        address: Of the cluster; None for that of the environment, or a new one on this machine.
        ship: Never run a cell in the experiment's folder.
    """

    def __init__(self, lock: Path, address: str | None, *, ship: bool) -> None:
        try:
            import ray
        except ImportError as error:
            raise UserError(f"--executor ray needs Ray (the extra 'ray'): {NEEDED}") from error
        self._ray = ray
        self._mine = not ray.is_initialized()  # not of a program that uses Ray itself
        if self._mine:
            _join(ray, address)
        content = lock.read_bytes()
        self._place = Place(
            lock=lock.absolute(), digest=hashlib.sha256(content).hexdigest(), ship=ship
        )
        self.slots = max(1, int(ray.cluster_resources().get("CPU", 1)))
        self.title = f"on a Ray cluster of {len(ray.nodes())} nodes and {self.slots} cores"
        # A task that its worker died in is retried by Ray; one that fails says so by itself.
        self._task: Callable[..., Any] = ray.remote(num_cpus=1, max_retries=RETRIES)(run_on_node)
        self._orders: dict[Future[Outcome], tuple[Order, Any]] = {}

    @property
    def running(self) -> Collection[str]:
        """Names of the cells that have begun in a folder which is seen from here."""
        return {
            order.name
            for future, (order, _) in self._orders.items()
            if not future.done() and order.run.exists()
        }

    def submit(self, order: Order) -> Future[Outcome]:
        """Hand over a cell; it begins when a node has a free core."""
        reference = self._task.remote(order.absolute(), self._place)  # type: ignore[attr-defined]
        future: Future[Outcome] = reference.future()
        self._orders[future] = (order, reference)
        return future

    def close(self) -> None:
        """Interrupt the cells that run, and leave the cluster; twice does nothing."""
        if not self._ray.is_initialized():
            return
        pending = {f: reference for f, (_, reference) in self._orders.items() if not f.done()}
        for reference in pending.values():
            self._ray.cancel(reference, force=False)
        if pending:
            wait(pending, timeout=END_S)
        if self._mine:
            self._ray.shutdown()


def _join(ray: Any, address: str | None) -> None:
    host, colon, port = (address or "").rpartition(":")
    try:
        if colon and port.isdigit():  # Ray itself would try for minutes
            socket.create_connection((host, int(port)), timeout=_CONNECT_S).close()
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        handler = signal.getsignal(signal.SIGTERM)
        ray.init(address=address, log_to_driver=False, logging_level="ERROR")
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, handler)  # Ray has put its own
    except (OSError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise UserError(
            f"cannot use the Ray cluster {address or 'of this machine'}: {reason}"
        ) from error
