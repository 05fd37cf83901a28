"""Error of a broken guarantee."""

from __future__ import annotations


class Violation(AssertionError):
    """A guarantee was broken."""
