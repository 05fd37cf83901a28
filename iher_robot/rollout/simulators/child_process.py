"""Child process that runs a program of this project: start, exchange messages, end."""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping
from multiprocessing.connection import Connection
from typing import Any

from drivers.closing import Closing
from iher_robot.errors import UserError
from iher_robot.rollout.simulators.messages import Message, receive_message, send_message

# -P: whatever lies in the working folder must not come before what this process imports.
_PYTHON = ("-P", "-c")
_END_S = 5.0
_KEPT = "nothing recorded is lost"


class ChildProcess(Closing):
    """Runs a program in a child process and exchanges messages with it.

    Not a child of ``multiprocessing``, which would run the user's script a second time. It ends by
    itself when this process does, however that ends.

    Args:
        program: Python source; its arguments are ``sys.path`` as JSON and the number of its socket.
        title: Its name in messages, such as ``"the learner's process"``.
        advice: What the user can do when it has ended, for messages.
    """

    def __init__(self, program: str, title: str, advice: str) -> None:
        self._program = program
        self._title = title
        self._advice = advice
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None
        self._torn = False

    @property
    def is_open(self) -> bool:
        """Whether it was started and not closed."""
        return self._connection is not None

    def lost_message(self) -> UserError:
        """The error where an interrupt cut off one of its messages."""
        return UserError(f"{self._title}: its last message was lost; {_KEPT}, {self._advice}")

    @property
    def connection(self) -> Connection:
        """The connection, for ``multiprocessing.connection.wait``."""
        assert self._connection is not None, "start comes first"
        return self._connection

    def start(self) -> None:
        """Start it, without waiting for it."""
        ours, its = socket.socketpair()
        with ours, its:
            paths, number = json.dumps(sys.path), str(its.fileno())
            # In a session of its own: a Ctrl-C is for the run, which ends it in order; and where
            # Linux shares time out by session, it takes none of the control loop's part.
            self._process = subprocess.Popen(
                [sys.executable, *_PYTHON, self._program, paths, number],
                stdin=subprocess.DEVNULL,
                pass_fds=(its.fileno(),),
                start_new_session=True,
            )
            self._connection = Connection(ours.detach())  # last: then messages can arrive

    def send(self, message: Mapping[str, Any]) -> None:
        """Send a message.

        Raises:
            UserError: The process is gone.
        """
        try:
            send_message(self.connection, message)
        except OSError:
            self._drain()
            raise self._ended() from None

    def receive(self, timeout_s: float) -> Message | None:
        """Receive a message.

        Args:
            timeout_s: Longest time to wait for it.

        Returns:
            The message; None if none arrives in time.

        Raises:
            UserError: The process is gone, or says why it cannot go on.
        """
        if self._torn:
            raise self.lost_message()
        try:
            if not self.connection.poll(timeout_s):
                return None
            self._torn = True  # an interrupt in the middle loses the message
            message = receive_message(self.connection)
        except (EOFError, OSError):
            raise self._ended() from None
        self._torn = False
        if message["kind"] == "failed":
            raise UserError(message["sentence"])
        return message

    def close(self) -> None:
        """End it; it holds nothing that is not stored here."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def _drain(self) -> None:
        """Read to the end: its last message may say why it ended."""
        while self.receive(_END_S) is not None:
            pass

    def _ended(self) -> UserError:
        assert self._process is not None
        try:
            code = self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            how = "fell silent"
        else:
            how = f"ended by itself with {_describe_exit(code)}"
        return UserError(f"{self._title} {how}; {_KEPT}, {self._advice}")


def exit_on_hangup(descriptor: int) -> None:
    """Exit this process at once, whatever it is doing, when its parent is gone.

    Args:
        descriptor: File descriptor of the socket to the parent.
    """
    threading.Thread(target=_end_at_hangup, args=(descriptor,), daemon=True).start()


def _end_at_hangup(descriptor: int) -> None:
    hangup = select.poll()
    hangup.register(descriptor, 0)  # no event but the hang-up
    hangup.poll()
    os._exit(1)


def _describe_exit(code: int) -> str:
    if code >= 0:
        return f"exit code {code}, see its messages above"
    return f"signal {signal.Signals(-code).name}"
