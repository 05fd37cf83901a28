"""A cell on a node of a Ray cluster."""

from __future__ import annotations

import dataclasses
import hashlib
import shutil
import socket
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from iher_robot.experiments.cell_process import Order, Outcome, run_order
from iher_robot.experiments.executor import END_S
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
