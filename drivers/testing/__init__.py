"""Conformance suite for robot drivers; it needs pytest.

A subclass of `DriverContract` among the tests of a driver checks that it keeps the contract of
`RobotDriver`; `docs/drivers.md` shows one.
"""

from __future__ import annotations

import pytest

# Before the modules are imported, so that a failing assert shows its values.
_TESTS = "commands excess following lifecycle resets states stopping suite ticks"
pytest.register_assert_rewrite(*(f"{__name__}.{module}" for module in _TESTS.split()))

from drivers.testing.command_samples import (  # noqa: E402
    CommandSamples,
    EndEffectorSamples,
    JointSamples,
)
from drivers.testing.contract import DriverContract  # noqa: E402

__all__ = ["CommandSamples", "DriverContract", "EndEffectorSamples", "JointSamples"]
