"""What a command says when it is interrupted."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_RESUMED_FROM = ("config.yaml", "ledger.sqlite")


class Stopped(Exception):
    """A command was interrupted; typer would turn the interrupt itself into a bare exit code."""


@contextmanager
def told_when_interrupted(folder: Path | None) -> Iterator[None]:
    """Say after an interrupt what is left to continue, as far as that is known.

    Args:
        folder: The run's folder, if it was named; the notes of the interrupt go first.
    """
    try:
        yield
    except KeyboardInterrupt as error:
        notes = list(getattr(error, "__notes__", ()))
        # Without settings and ledger there is nothing to resume.
        if not notes and folder and all((folder / name).is_file() for name in _RESUMED_FROM):
            notes = [f"continue with: iher-robot train --resume {shlex.quote(str(folder))}"]
        raise Stopped("; ".join(["interrupted", *notes])) from error
