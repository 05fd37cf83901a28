"""The process of a learner, as the run that started it sees it."""

from __future__ import annotations

import json
import shlex
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from drivers.closing import Closing
from iher_robot.errors import UserError
from iher_robot.learner_messages import Message, receive_message, send_message

# -P: whatever lies in the working folder must not come before what this process imports.
_PYTHON = ("-P", "-c")
PROGRAM = """
import json, os, sys
sys.path[:] = json.loads(sys.argv[1])
os.nice(10)  # on a busy machine the control loop goes first
from iher_robot.learner_program import main
main(int(sys.argv[2]))
"""
"""What the process runs."""
_END_S = 5.0


class LearnerProcess(Closing):
    """Starts it, talks to it, and ends it.

    A program of its own rather than a child of ``multiprocessing``: that would run the user's
    script a second time. It ends by itself when this process does, however that ends.

    Args:
        run: Folder of the run, which can be resumed later.
    """

    def __init__(self, run: Path) -> None:
        self._run = run
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None

    def start(self) -> None:
        """Start it; it is not waited for."""
        ours, its = socket.socketpair()
        self._connection = Connection(ours.detach())
        with its:
            command = [sys.executable, *_PYTHON, PROGRAM, json.dumps(sys.path), str(its.fileno())]
            # In a session of its own: a Ctrl-C is for the run, which ends it in order; and where
            # Linux shares time out by session, the learner takes none of the control loop's part.
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                pass_fds=(its.fileno(),),
                start_new_session=True,
            )

    def send(self, message: Mapping[str, Any]) -> None:
        """Send a message.

        Raises:
            UserError: The process is gone.
        """
        assert self._connection is not None
        try:
            send_message(self._connection, message)
        except OSError:
            self._drain()
            raise self._ended() from None

    def receive(self, timeout_s: float) -> Message | None:
        """Receive a message.

        Args:
            timeout_s: Longest time to wait for it.

        Returns:
            The message, None where there is none in time.

        Raises:
            UserError: The process is gone, or says why it cannot go on.
        """
        assert self._connection is not None
        try:
            if not self._connection.poll(timeout_s):
                return None
            message = receive_message(self._connection)
        except (EOFError, OSError):
            raise self._ended() from None
        if message["kind"] == "failed":
            raise UserError(message["sentence"])
        return message

    def close(self) -> None:
        """End it; it keeps nothing that is not kept here."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def _drain(self) -> None:
        """Read to the end: before it went it may have said why."""
        while self.receive(_END_S) is not None:
            pass

    def _ended(self) -> UserError:
        assert self._process is not None
        try:
            code = self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            how = "fell silent"
        else:
            how = f"ended by itself with {_in_words(code)}"
        return UserError(
            f"the learner's process {how}; nothing recorded is lost, continue with: "
            f"iher-robot train --resume {shlex.quote(str(self._run))}"
        )


def _in_words(code: int) -> str:
    if code >= 0:
        return f"exit code {code}, see its messages above"
    return f"signal {signal.Signals(-code).name}"
