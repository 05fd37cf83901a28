"""A learner in a process of its own, one epoch behind the robot."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from iher_robot.learning.progress import Progress
from iher_robot.rollout.simulators.child_process import ChildProcess
from iher_robot.rollout.simulators.messages import Message, pack_episodes
from iher_robot.training.epoch import EpochData, Learned
from iher_robot.training.learners.base import RunLearner
from iher_robot.training.learners.messages import begin_messages
from iher_robot.training.recovery import Restored
from iher_robot.training.setup import TrainingSetup

PROGRAM = """
import json, os, sys
sys.path[:] = json.loads(sys.argv[1])
os.nice(10)  # on a busy machine the control loop goes first
from iher_robot.training.learners.async_worker import main
main(int(sys.argv[2]))
"""
"""What the process runs."""


class LearnerProcess(ChildProcess):
    """Starts it, talks to it, and ends it.

    Args:
        run: Folder of the run, which can be resumed later.
    """

    def __init__(self, run: Path) -> None:
        command = f"iher-robot train --resume {shlex.quote(str(run))}"
        super().__init__(PROGRAM, "the learner's process", f"continue with: {command}")


_LOOK_S = 0.2


class AsyncLearner(RunLearner):
    """Learns an epoch while the robot collects the next one.

    Here is a copy of the learner that acts, replaced by each epoch that comes back: in simulation
    when the next one was collected, so that a run depends on no clock; on a robot in real time
    between two episodes, as soon as it is there.

    Args:
        cell: Robot, and the learner that acts.
        process: Where learning happens.
        progress: Told how far each phase is while an epoch is waited for.
    """

    def __init__(self, cell: TrainingSetup, process: LearnerProcess, progress: Progress) -> None:
        super().__init__(cell.learner)
        self._cell = cell
        self._process = process
        self._progress = progress
        self._prompt = cell.env.driver.paces_itself
        self._phase = ("learn", 0, 0)
        self._arrived: Message | None = None
        self._state: dict[str, Any] = {}

    def begin(self, restored: Restored) -> None:
        """Take over the state of a stopped run, or begin as a new one."""
        self._process.start()
        for message in begin_messages(self._cell, restored):
            self._process.send(message)
        if restored.learner is not None:
            self._act_as(restored.learner)

    def exchange(self, lesson: EpochData | None) -> Learned | None:
        """Wait for the epoch under way, and hand the next one over."""
        learned = None if self.under_way is None else Learned(self.under_way, self._wait())
        self.under_way = lesson
        if lesson is not None:
            self._process.send(
                {
                    "kind": "learn",
                    "episodes": pack_episodes(lesson.episodes),
                    "evaluate": lesson.evaluate,
                }
            )
        return learned

    def look(self) -> None:
        """Take in what has arrived."""
        while self._receive(0.0):
            pass
        if self._prompt and self._arrived is not None:
            self._catch_up(self._arrived["state"])

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint keeps of the learner."""
        return self._state

    def close(self) -> None:
        """End the process."""
        self._process.close()

    def _wait(self) -> dict[str, float]:
        while self._arrived is None:
            self._receive(_LOOK_S)
            self._progress(*self._phase)
        message, self._arrived = self._arrived, None
        self._catch_up(message["state"])
        metrics: dict[str, float] = message["metrics"]
        return metrics

    def _receive(self, timeout_s: float) -> bool:
        message = self._process.receive(timeout_s)
        if message is None:
            return False
        if message["kind"] == "progress":
            self._phase = (message["phase"], message["done"], message["total"])
        else:
            self._arrived, self._phase = message, ("learn", 0, 0)
        return True

    def _catch_up(self, state: dict[str, Any]) -> None:
        if self._state is not state:
            self._act_as(state)

    def _act_as(self, state: dict[str, Any]) -> None:
        # Streams of another device do not fit here, and nothing that acts draws from them.
        ours = {"generator": self.learner.generator.get_state()}
        if self.learner.contact is not None:
            ours["contact"] = state["contact"] | {
                "generator": self.learner.contact.generator.get_state()
            }
        self.learner.load_state_dict(state | ours, ())
        self._state = state
