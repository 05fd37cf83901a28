"""The process of a learner, as the run that started it sees it."""

from __future__ import annotations

import shlex
from pathlib import Path

from iher_robot.rollout.simulators.child_process import OwnProcess

PROGRAM = """
import json, os, sys
sys.path[:] = json.loads(sys.argv[1])
os.nice(10)  # on a busy machine the control loop goes first
from iher_robot.training.learners.async_worker import main
main(int(sys.argv[2]))
"""
"""What the process runs."""


class LearnerProcess(OwnProcess):
    """Starts it, talks to it, and ends it.

    Args:
        run: Folder of the run, which can be resumed later.
    """

    def __init__(self, run: Path) -> None:
        command = f"iher-robot train --resume {shlex.quote(str(run))}"
        super().__init__(PROGRAM, "the learner's process", f"continue with: {command}")
