"""SIGTERM ends the program as Ctrl-C does."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

_arrived = threading.Event()


class Terminated(KeyboardInterrupt):
    """SIGTERM arrived: whatever a Ctrl-C settles, holds and disarms, this does too."""


@contextmanager
def sigterm_as_interrupt() -> Iterator[None]:
    """Let SIGTERM unwind the program as Ctrl-C does, instead of ending it on the spot."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may set handlers
        return

    def terminate(number: int, frame: FrameType | None) -> NoReturn:  # noqa: ARG001
        # A second one must not cut short what settles the ledger and disarms the robot.
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        _arrived.set()
        raise Terminated

    before = signal.signal(signal.SIGTERM, terminate)
    try:
        yield
    finally:
        _arrived.clear()
        # Where it is ignored the process is about to exit, and with a code of its own.
        if signal.getsignal(signal.SIGTERM) is terminate:
            signal.signal(signal.SIGTERM, before)


def end_if_terminated() -> None:
    """Raise `Terminated` if a SIGTERM has arrived: work goes on that it should have ended.

    Python raises in whatever the main thread does at that moment, and drops what is raised in a
    finalizer or in a callback of the garbage collector. So work that goes on for long, above all
    work that moves a robot, asks here between its steps.

    Raises:
        Terminated: A SIGTERM has arrived since `sigterm_as_interrupt` was entered.
    """
    if _arrived.is_set():
        raise Terminated
