"""Asynchronous learner: a child process learns, one epoch behind the robot."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from iher_robot.learning.progress import Progress
from iher_robot.rollout.simulators.child_process import ChildProcess
from iher_robot.rollout.simulators.messages import Message, pack_episodes
from iher_robot.training.epoch import EpochData, LearnedEpoch
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
"""Source of the process."""


class LearnerProcess(ChildProcess):
    """The child process that learns.

    Args:
        run: The run folder, for advice in messages.
    """

    def __init__(self, run: Path) -> None:
        command = f"iher-robot train --resume {shlex.quote(str(run))}"
        super().__init__(PROGRAM, "the learner's process", f"continue with: {command}")


_LOOK_S = 0.2


class AsyncLearner(RunLearner):
    """Learns an epoch while the robot collects the next one.

    This process has a copy of the learner, which acts. Each epoch that comes back replaces it: in
    simulation when the next epoch was collected, so that a run depends on no clock; on a robot in
    real time between two episodes, as soon as it arrives.

    Args:
        setup: Robot, and the learner that acts.
        process: The child process.
        progress: Called with the progress of each phase while waiting for an epoch.
    """

    def __init__(self, setup: TrainingSetup, process: LearnerProcess, progress: Progress) -> None:
        super().__init__(setup.learner)
        self._setup = setup
        self._process = process
        self._progress = progress
        self._prompt = setup.env.driver.paces_itself
        self._phase = ("learn", 0, 0)
        self._arrived: Message | None = None
        self._state: dict[str, Any] = {}

    def begin(self, restored: Restored) -> None:
        """Start as a new run, or from the state of a stopped one."""
        self._process.start()
        for message in begin_messages(self._setup, restored):
            self._process.send(message)
        if restored.learner is not None:
            self._act_as(restored.learner)

    def exchange(self, epoch: EpochData | None) -> LearnedEpoch | None:
        """Wait for the epoch under way, and hand the next one over."""
        learned = None if self.under_way is None else LearnedEpoch(self.under_way, self._wait())
        self.under_way = epoch
        if epoch is not None:
            self._process.send(
                {
                    "kind": "learn",
                    "episodes": pack_episodes(epoch.episodes),
                    "evaluate": epoch.evaluate,
                }
            )
        return learned

    def look(self) -> None:
        """Receive messages, and switch to a newer policy on a robot in real time."""
        while self._receive(0.0):
            pass
        if self._prompt and self._arrived is not None:
            self._catch_up(self._arrived["state"])

    def state_dict(self) -> dict[str, Any]:
        """State for a checkpoint."""
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
        # Random states of another device do not fit here, and acting does not draw from them.
        ours = {"generator": self.learner.generator.get_state()}
        if self.learner.contact is not None:
            ours["contact"] = state["contact"] | {
                "generator": self.learner.contact.generator.get_state()
            }
        self.learner.load_state_dict(state | ours, ())
        self._state = state
