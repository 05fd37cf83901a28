"""Command line: parses options, calls the applications, prints results."""

from __future__ import annotations

from iher_robot.cli.app import main

__all__ = ["main"]
