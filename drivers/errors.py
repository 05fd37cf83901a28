"""What can go wrong with a robot.

Every message carries the name, the value, what is allowed and what to do.
"""

from __future__ import annotations


class DriverError(Exception):
    """Base of every error that a driver raises."""


class UnknownDriver(DriverError, ValueError):
    """No driver has this name."""


class InvalidSpec(DriverError, ValueError):
    """A robot describes itself in a way that contradicts itself or is unsafe."""


class InvalidCommand(DriverError, ValueError):
    """A command that this robot can never carry out: a bug of the sender, not of the moment."""


class InvalidRequest(DriverError, ValueError):
    """A request that this robot can never fulfil, such as a place for an object it has not."""


class LifecycleError(DriverError, RuntimeError):
    """A call out of order, such as reading a driver that is not open."""


class HandsNotClear(LifecycleError):
    """Motion was asked for after human help and before hands were confirmed clear."""


class FaultLatched(DriverError, RuntimeError):
    """The robot is stopped until an operator clears the fault by its name."""


class StaleState(DriverError, RuntimeError):
    """The newest measurement is older than the caller accepts."""


class LinkLost(DriverError, ConnectionError):
    """A remote robot does not answer in time, or its host was started anew."""


class LeaseRefused(DriverError, RuntimeError):
    """Somebody else holds the right to command a remote robot, or took it over."""
