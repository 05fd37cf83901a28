"""Conformance suite for robot drivers, for authors of drivers. It needs pytest.

A driver proves that it keeps the contract of `RobotDriver` by a subclass of `DriverContract`
among its tests; `docs/drivers.md` shows one.
"""

from __future__ import annotations

from drivers.testing import CommandSamples, DriverContract, EndEffectorSamples, JointSamples

__all__ = ["CommandSamples", "DriverContract", "EndEffectorSamples", "JointSamples"]
