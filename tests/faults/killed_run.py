"""One run on a served robot, killed and resumed until it is finished."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.faults.host_log import HostLog, LoggedTick
from tests.faults.learner import Learner
from tests.faults.moments import Kind, Moment, Scene
from tests.faults.run_folder import Found, Witness, check_finished, compare, look_into
from tests.faults.small_disk import SmallDisk
from tests.faults.violation import Violation

TICKS_PER_MINUTE = 1500
_FINISH_S = 300.0
_PATIENT_S = 30.0
_FULL = "No space left on device|disk I/O error"
"""The second is SQLite's message if its shared memory has no room."""
_QUICK = ("evaluation.robot_episodes=1", "learner.schedule.updates_per_step=1")


@dataclass(frozen=True)
class Place:
    """Environment of a run.

    Attributes:
        folder: Folder of the run.
        scratch: Folder for output of its processes, and for copies.
        endpoint: Endpoint of the host.
        log: Tick log of the host.
        disk: Disk of the folder, if it can be filled.
        libraries: Libraries to preload into a learner, by name.
    """

    folder: Path
    scratch: Path
    endpoint: str
    log: HostLog
    disk: SmallDisk | None
    libraries: Mapping[str, Path]


class KilledRun:
    """A run, with the host's record of each of its processes.

    Attributes:
        kills: Kills so far.
        found: Content of its folder after the last kill.
        witness: The host's record until then.
        finished: Whether it has ended by itself.
        overcount: Ticks that its ledger over-counts.
        left: Unfinished work that the last kill left.
    """

    def __init__(self, place: Place, budget_minutes: float) -> None:
        self.kills = 0
        self.found = Found({"motion": 0, "evaluation": 0})
        self.witness = Witness.of([])
        self.finished = False
        self.overcount = 0
        self.left = ""
        self._place = place
        self._budget_minutes = budget_minutes
        self._killed: list[list[LoggedTick]] = []
        self._processes = 0

    @property
    def remaining_ticks(self) -> int:
        return max(0, round(self._budget_minutes * TICKS_PER_MINUTE) - self.found.spent["motion"])

    @property
    def in_flight(self) -> int:
        """Number of ticks that are in no episode."""
        return len(set(self.witness.true_ticks) - self.found.covered.keys())

    def strike(self, moment: Moment) -> bool:
        """Run a process until a moment, and kill it.

        Returns:
            Whether the moment came before the run finished.

        Raises:
            Violation: A guarantee was broken.
        """
        log = self._place.log
        log.read()
        begun = len(log.ticks)
        with self._start(moment) as learner:
            came = Scene(learner, self._place.folder, log).wait(moment)
            if came and moment.kind is Kind.FULL_DISK:
                came = self._fill_the_disk(learner, moment)
            elif came:
                learner.kill()
            if not came:
                learner.require_ending(0)
        log.settle()
        self._take(log.ticks[begun:], was_killed=came)
        return came

    def finish(self) -> None:
        """Run a process to the end of the run.

        Raises:
            Violation: The run does not end, or a guarantee was broken.
        """
        log = self._place.log
        log.read()
        begun = len(log.ticks)
        with self._start() as learner:
            learner.wait(_FINISH_S)
            learner.require_ending(0)
        log.settle()
        self._take(log.ticks[begun:], was_killed=False)

    def _start(self, moment: Moment | None = None) -> Learner:
        place = self._place
        self._processes += 1
        options = ["--quiet"]
        if (place.folder / "config.yaml").exists():
            options += ["--resume", str(place.folder)]
        else:
            options += ["--out", str(place.folder), "--driver", "zenoh", "--task", "reach"]
            options += ["--connect", place.endpoint, "--budget-minutes", str(self._budget_minutes)]
            options += ["--until-success", "off", "--seed", place.folder.name.rsplit("-", 1)[-1]]
            options += [word for setting in _QUICK for word in ("--set", setting)]
        environment = {}
        if moment is not None and moment.world in place.libraries:
            environment["LD_PRELOAD"] = str(place.libraries[moment.world])
            environment["JUMPING_CLOCK_SEED"] = str(moment.world_seed)
        output = place.scratch / f"{place.folder.name}.{self._processes:02d}.txt"
        return Learner(options, output, environment)

    def _fill_the_disk(self, learner: Learner, moment: Moment) -> bool:
        """Fill the disk; the learner ends with one sentence about it, or is killed before.

        Returns:
            Whether it was kept from finishing.
        """
        disk = self._place.disk
        assert disk is not None
        disk.fill()
        try:
            code = learner.wait(moment.patience_s)
            if code is None and moment.patience_s >= _PATIENT_S:
                raise Violation(f"the learner continues for {moment.patience_s:g} s on a full disk")
            learner.kill()
        finally:
            disk.clear()
        if code is not None and code != 0:
            learner.require_ending(2, rf"{re.escape(str(self._place.folder))}.*({_FULL})")
        return code != 0

    def _take(self, ticks: list[LoggedTick], *, was_killed: bool) -> None:
        """Record the ticks of a process, and check the folder."""
        folder = self._place.folder
        if was_killed:
            self.kills += 1
            self._killed.append(ticks)
        unharmed = [] if was_killed else ticks
        self.finished = not was_killed
        self.left = "before its folder was made"
        if not (folder / "config.yaml").exists():
            if any(tick.commanded for tick in ticks) or (folder.exists() and any(folder.iterdir())):
                raise Violation(f"{folder} can neither be resumed nor started again")
            return
        self.found = look_into(folder, self._place.scratch)
        begun = any(tick.commanded for tick in ticks)
        self.left = self.found.left or ("after some ticks" if begun else "before its first tick")
        self.witness = Witness.of(self._killed, unharmed)
        self.overcount = compare(self.found, self.witness, self.kills)
        if self.finished:
            budget_ticks = round(self._budget_minutes * TICKS_PER_MINUTE)
            check_finished(folder, self.found, budget_ticks)
