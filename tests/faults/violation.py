"""What a run that is killed must never come to."""

from __future__ import annotations


class Violation(AssertionError):
    """A guarantee was broken."""
