"""What authors of drivers test with. It needs pytest.

A driver proves that it keeps the contract of `RobotDriver` by a subclass of `DriverContract`
among its tests; `docs/drivers.md` shows one.
"""

from __future__ import annotations

import pytest

# Before the modules are imported: a failing assert then shows the values in it.
_TESTS = "commands excess following lifecycle resets states stopping suite ticks"
pytest.register_assert_rewrite(*(f"{__name__}.{module}" for module in _TESTS.split()))

from drivers.testing.command_samples import (  # noqa: E402
    CommandSamples,
    EndEffectorSamples,
    JointSamples,
)
from drivers.testing.contract import DriverContract  # noqa: E402

__all__ = ["CommandSamples", "DriverContract", "EndEffectorSamples", "JointSamples"]
