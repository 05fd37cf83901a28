"""Progress of a learner's phases."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called with the phase's name, the steps done and their total."""


def silent(phase: str, done: int, total: int) -> None:
    """Report no progress."""
