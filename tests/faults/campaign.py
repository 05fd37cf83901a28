"""Campaign of kills: runs on a served robot, checked after each kill."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from iher_robot.storage.ledger import Ledger
from tests.faults.host_log import HostLog
from tests.faults.killed_run import KilledRun, Place
from tests.faults.moments import JUMPING_CLOCK, SLOW_DISK, Kind, draw_moment
from tests.faults.preloaded import build_jumping_clock, build_library
from tests.faults.small_disk import SmallDisk
from tests.faults.violation import Violation
from tests.served.served_robot import ServedRobot

KILLS_PER_RUN = 5
_SHARES = {
    Kind.ANY_TIME: 34,
    Kind.EPISODE: 18,
    Kind.EVALUATION: 10,
    Kind.CHECKPOINT: 12,
    Kind.SEALING: 10,
    Kind.FULL_DISK: 8,
    Kind.JUMPING_CLOCK: 8,
}
"""Share of each kind among 100 kills."""


def deal(kills: int, seed: int) -> list[Kind]:
    """Draw the kind of each kill: every kind by its share, in random order."""
    kinds = list(_SHARES)
    parts = np.array(list(_SHARES.values())) / sum(_SHARES.values())
    deck = [kind for kind, part in zip(kinds, parts, strict=True) for _ in range(int(part * kills))]
    rng = np.random.default_rng([seed, 0])
    deck += [kinds[i] for i in rng.choice(len(kinds), kills - len(deck), p=parts)]
    return [deck[i] for i in rng.permutation(kills)]


@dataclass
class Findings:
    """Results of a campaign.

    Attributes:
        kills: Kills by kind.
        left: Kills by the unfinished work that they left.
        not_run: Kinds that this machine does not permit, with the reason.
        runs: Finished runs.
        true_ticks: Ticks in which a command of these runs was in force.
        in_flight: Those of them that are in no episode.
        overcounts: Kills and over-counted ticks of each run.
    """

    kills: Counter[str] = field(default_factory=Counter)
    left: Counter[str] = field(default_factory=Counter)
    not_run: dict[str, str] = field(default_factory=dict)
    runs: int = 0
    true_ticks: int = 0
    in_flight: int = 0
    overcounts: list[tuple[int, int]] = field(default_factory=list)

    def take(self, run: KilledRun) -> None:
        """Add a finished run."""
        self.runs += 1
        self.true_ticks += len(run.witness.true_ticks)
        self.in_flight += run.in_flight
        self.overcounts.append((run.kills, run.overcount))


class Campaign:
    """A host, and consecutive runs on it.

    Args:
        folder: Folder of everything.
        kinds: Kind of each kill, in order.
        seed: Seed of the moments.
        budget_minutes: Robot minutes of a run.
        echo: Prints progress.
    """

    def __init__(
        self,
        folder: Path,
        kinds: Sequence[Kind],
        seed: int,
        budget_minutes: float,
        echo: Callable[[str], None],
    ) -> None:
        self.findings = Findings()
        self._folder = folder
        self._kinds = list(kinds)
        self._planned = len(kinds)
        self._budget_minutes = budget_minutes
        self._rng = np.random.default_rng([seed, 1])
        self._echo = echo
        self._disk: SmallDisk | None = None
        self._libraries: dict[str, Path] = {}

    def run(self) -> Findings:
        """Make every kill, and let each run finish.

        Raises:
            Violation: A guarantee was broken; the folder shows it.
        """
        with ExitStack() as stack:
            self._prepare(stack)
            log_path = self._folder / "ticks.jsonl"
            memory = self._folder / "memory"
            try:
                options = ("--tick-log", str(log_path), "--deadman", "1")
                with ServedRobot(memory, *options) as host:
                    log = HostLog(log_path)
                    while self._kinds:
                        self._one_run(host.endpoint, log)
                self._check_total(log)
            except BaseException:
                if self._disk is not None:
                    shutil.copytree(self._disk.folder, self._folder / "small disk, a copy")
                raise
        return self.findings

    def _prepare(self, stack: ExitStack) -> None:
        """Prepare disk and libraries, and leave out kinds that this machine does not permit."""
        try:
            self._disk = stack.enter_context(SmallDisk(self._folder / "small"))
        except OSError as error:
            self._leave_out(Kind.FULL_DISK, str(error))
        try:
            self._libraries[JUMPING_CLOCK] = build_jumping_clock(self._folder)
            self._libraries[SLOW_DISK] = build_library(SLOW_DISK, self._folder)
        except OSError as error:
            self._leave_out(Kind.JUMPING_CLOCK, str(error))

    def _leave_out(self, kind: Kind, reason: str) -> None:
        if kind in self._kinds:
            self.findings.not_run[kind] = reason
            self._echo(f"NOT RUN: kills {kind}: {reason}")
            self._kinds = [each for each in self._kinds if each is not kind]

    def _one_run(self, endpoint: str, log: HostLog) -> None:
        hand = self._kinds[:KILLS_PER_RUN]
        disk = self._disk if Kind.FULL_DISK in hand else None
        folder = (self._folder if disk is None else disk.folder) / f"run-{self.findings.runs:03d}"
        place = Place(folder, self._folder, endpoint, log, disk, self._libraries)
        run = KilledRun(place, self._budget_minutes)
        try:
            for kind in hand:
                moment = draw_moment(kind, self._rng, run.remaining_ticks)
                if not run.strike(moment):
                    break
                self._kinds.pop(0)
                self.findings.kills[kind] += 1
                self._report(run, kind)
            if not run.finished:
                run.finish()
        except Violation as violation:
            violation.add_note(f"{folder.name}, after {run.kills} kills; the last aim: {moment}")
            raise
        self.findings.take(run)
        self._echo(f"{folder.name} finished after {run.kills} kills")
        shutil.rmtree(folder)

    def _report(self, run: KilledRun, kind: Kind) -> None:
        self.findings.left[run.left] += 1
        made = self.findings.kills.total()
        self._echo(
            f"kill {made:3d} of {self._planned}, {kind}; {run.left}; "
            f"{run.found.spent['motion']} ticks of motion, {run.in_flight} in flight, "
            f"{run.overcount} counted too much"
        )

    def _check_total(self, log: HostLog) -> None:
        log.read()
        armed = sum(tick.armed for tick in log.ticks)
        with Ledger(self._folder / "memory" / "total.sqlite") as total:
            counted = total.spent_ticks("motion")
        if counted < armed:
            raise Violation(f"the robot's own total is {counted}, it was armed in {armed} ticks")
