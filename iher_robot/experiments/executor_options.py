"""Options of an experiment's executor: validation and creation."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

from iher_robot.errors import UserError, unknown_name
from iher_robot.experiments.executor import Executor, LocalExecutor
from iher_robot.experiments.grid import Cell
from iher_robot.storage.files.lock import LockFile

EXECUTORS = ("local", "ray")


@dataclass(frozen=True)
class ExecutorOptions:
    """Options that select an executor.

    Attributes:
        executor: ``local`` or ``ray``.
        workers: Number of parallel cells with ``local``; None for one per core.
        address: Address of the Ray cluster; None for the default.
        ship: Run cells on the nodes' own disks.
    """

    executor: str
    workers: int | None
    address: str | None
    ship: bool

    def check(self, cells: Sequence[Cell]) -> None:
        """Refuse options that exclude each other or do not fit the cells.

        Raises:
            UserError: An option is refused.
        """
        if self.executor not in EXECUTORS:
            raise unknown_name("executor", self.executor, EXECUTORS)
        if self.workers is not None and self.workers < 1:
            raise UserError(f"--workers is {self.workers}, allowed: an integer, 1 or more")
        if self.executor == "ray":
            if self.workers is not None:
                raise UserError(
                    "--workers is for --executor local; a Ray cluster runs one cell per core of "
                    "its nodes; leave it out"
                )
            for cell in cells:
                if not cell.simulated:
                    raise UserError(
                        f"cell {cell.name} runs on {cell.identity.robot}, which parallel cells "
                        "must not share; use --executor local"
                    )
        elif self.address is not None or self.ship:
            raise UserError("--address and --ship are for --executor ray; leave them out")

    def make(self, cells: Sequence[Cell], lock: LockFile) -> Executor:
        """Create the executor.

        Args:
            cells: Cells of the experiment.
            lock: Held lock in the folder of the experiment.
        """
        if self.executor == "ray":
            from iher_robot.experiments.ray import RayExecutor

            return RayExecutor(lock.path, self.address, ship=self.ship)
        if not all(cell.simulated for cell in cells):
            return LocalExecutor(1, "one at a time, since they share a robot")
        return LocalExecutor(self.workers or len(os.sched_getaffinity(0)))
