"""Handle SIGTERM like Ctrl-C."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

_arrived = threading.Event()


class Terminated(KeyboardInterrupt):
    """SIGTERM arrived; cleans up like a `KeyboardInterrupt`."""


@contextmanager
def sigterm_as_interrupt() -> Iterator[None]:
    """Raise `Terminated` on SIGTERM, instead of ending the process at once."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may set handlers
        return

    def terminate(number: int, frame: FrameType | None) -> NoReturn:  # noqa: ARG001
        # A second one must not interrupt the settling of the ledger and the disarming of the robot.
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        _arrived.set()
        raise Terminated

    before = signal.signal(signal.SIGTERM, terminate)
    try:
        yield
    finally:
        _arrived.clear()
        # If it is ignored, the process is about to exit with its own code.
        if signal.getsignal(signal.SIGTERM) is terminate:
            signal.signal(signal.SIGTERM, before)


def end_if_terminated() -> None:
    """Raise `Terminated` if a SIGTERM has arrived and its exception was lost.

    Python raises wherever the main thread happens to be, and discards exceptions in finalizers and
    in callbacks of the garbage collector. Long work, above all work that moves a robot, calls this
    between its steps.

    Raises:
        Terminated: A SIGTERM has arrived since `sigterm_as_interrupt` was entered.
    """
    if _arrived.is_set():
        raise Terminated
