"""Message of an interrupted command, with how to continue."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_RESUMED_FROM = ("config.yaml", "ledger.sqlite")


class Stopped(Exception):
    """A command was interrupted; typer would turn the interrupt itself into a bare exit code."""


@contextmanager
def report_interrupts(folder: Path | None) -> Iterator[None]:
    """Raise `Stopped` after an interrupt, with the command to continue a run if there is one.

    Args:
        folder: The run's folder, if given; notes of the interrupt take precedence.
    """
    try:
        yield
    except KeyboardInterrupt as error:
        notes = list(getattr(error, "__notes__", ()))
        # A run without settings and ledger cannot be resumed.
        if not notes and folder and all((folder / name).is_file() for name in _RESUMED_FROM):
            notes = [f"continue with: iher-robot train --resume {shlex.quote(str(folder))}"]
        raise Stopped("; ".join(["interrupted", *notes])) from error
