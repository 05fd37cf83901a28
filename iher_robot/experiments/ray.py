"""Ray executor: cells as tasks of a Ray cluster."""

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
from iher_robot.experiments.cell_process import CellJob, Outcome, run_cell
from iher_robot.experiments.executor import SHUTDOWN_S, Executor
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.storage.run_directory import RunDirectory

NEEDED = "pip install 'iher-robot[ray]'"

RETRIES = 10
"""Number of times a cell is rescheduled after its node was lost."""

_CONNECT_S = 10.0


@dataclass(frozen=True)
class SharedFolder:
    """Lets a node find out whether it sees the folder of an experiment.

    Attributes:
        lock: A file in the folder.
        digest: SHA-256 of its content, which is unique to the experiment.
        ship: Run cells on the node's own disk even where the folder is visible.
    """

    lock: Path
    digest: str
    ship: bool

    @property
    def is_visible(self) -> bool:
        """Whether this node sees the folder."""
        try:
            return hashlib.sha256(self.lock.read_bytes()).hexdigest() == self.digest
        except OSError:
            return False


class RayExecutor(Executor):
    """Runs cells as tasks of one core each, on any node of a Ray cluster.

    A node that sees the folder of the experiment at the same path runs a cell there. If that node
    is lost, another one continues from the last epoch, and so does a later experiment. A node that
    does not see the folder runs the cell on its own disk and sends small files back once it has
    finished. If that node is lost, its cells start again from the beginning.

    Args:
        lock: File in the experiment's folder by which a node checks whether it sees the folder.
        address: Address of the cluster; None for that of the environment, or a new one on this
            machine.
        ship: Never run a cell in the experiment's folder.
    """

    def __init__(self, lock: Path, address: str | None, *, ship: bool) -> None:
        try:
            import ray
        except ImportError as error:
            raise UserError(f"--executor ray needs Ray (the extra 'ray'): {NEEDED}") from error
        self._ray = ray
        self._owns_connection = not ray.is_initialized()  # else the calling program uses Ray too
        if self._owns_connection:
            _connect(ray, address)
        content = lock.read_bytes()
        self._shared = SharedFolder(
            lock=lock.absolute(), digest=hashlib.sha256(content).hexdigest(), ship=ship
        )
        self.slots = max(1, int(ray.cluster_resources().get("CPU", 1)))
        self.title = f"on a Ray cluster of {len(ray.nodes())} nodes and {self.slots} cores"
        # Ray retries a task whose worker died; a cell that fails returns an outcome instead.
        self._task: Callable[..., Any] = ray.remote(num_cpus=1, max_retries=RETRIES)(run_on_node)
        self._jobs: dict[Future[Outcome], tuple[CellJob, Any]] = {}

    @property
    def running(self) -> Collection[str]:
        """Names of the cells that have started in a folder visible from here."""
        return {
            job.name
            for future, (job, _) in self._jobs.items()
            if not future.done() and job.run.exists()
        }

    def submit(self, job: CellJob) -> Future[Outcome]:
        """Queue a cell; it starts when a node has a free core."""
        reference = self._task.remote(job.absolute(), self._shared)  # type: ignore[attr-defined]
        future: Future[Outcome] = reference.future()
        self._jobs[future] = (job, reference)
        return future

    def close(self) -> None:
        """Interrupt the cells that run and disconnect from the cluster; idempotent."""
        if not self._ray.is_initialized():
            return
        pending = {f: reference for f, (_, reference) in self._jobs.items() if not f.done()}
        for reference in pending.values():
            self._ray.cancel(reference, force=False)
        if pending:
            wait(pending, timeout=SHUTDOWN_S)
        if self._owns_connection:
            self._ray.shutdown()


def run_on_node(job: CellJob, shared: SharedFolder) -> Outcome:
    """Run a cell, in the experiment's folder where this node sees it.

    Args:
        job: The cell, with absolute paths.
        shared: Folder of the experiment.

    Returns:
        How it ended, and small files of its run if that is on this node's own disk.
    """
    node = socket.gethostname()
    if shared.is_visible and not shared.ship:
        return dataclasses.replace(_run(job), node=node)
    # The same path at each retry, so that one on this node continues.
    scratch = ExperimentFolder(Path(tempfile.gettempdir()) / f"iher-robot-{shared.digest[:16]}")
    local = dataclasses.replace(
        job,
        config_path=scratch.config(job.name),
        run=scratch.run(job.name).path,
        log=scratch.log(job.name),
    )
    outcome = _run(local)
    files = {"log": local.log.read_bytes()} if local.log.exists() else {}
    if outcome.ending == "finished":
        files |= _small_files(local.run)
        shutil.rmtree(local.run)
    return dataclasses.replace(outcome, node=node, files=files)


def _run(job: CellJob) -> Outcome:
    processes: list[subprocess.Popen[bytes]] = []
    try:
        return run_cell(job, processes.append, lambda: False)
    except KeyboardInterrupt:  # the experiment was interrupted: Ray cancels the task
        for process in processes:
            process.terminate()
            process.wait(SHUTDOWN_S)
        return Outcome(job.name, "interrupted", "interrupted")


def _small_files(path: Path) -> dict[str, bytes]:
    """What tables and reports need, and the policy; episodes and checkpoint are not sent."""
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


def _connect(ray: Any, address: str | None) -> None:
    host, colon, port = (address or "").rpartition(":")
    try:
        if colon and port.isdigit():  # Ray itself would retry for minutes
            socket.create_connection((host, int(port)), timeout=_CONNECT_S).close()
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        handler = signal.getsignal(signal.SIGTERM)
        ray.init(address=address, log_to_driver=False, logging_level="ERROR")
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, handler)  # Ray has installed its own
    except (OSError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise UserError(
            f"cannot use the Ray cluster {address or 'of this machine'}: {reason}"
        ) from error
