"""Errors of drivers. Every message gives the name, the value, what is allowed and what to do."""

from __future__ import annotations


class DriverError(Exception):
    """Base of every error that a driver raises."""


class UnknownDriver(DriverError, ValueError):
    """No driver has this name."""


class InvalidSpec(DriverError, ValueError):
    """A robot's description is contradictory or unsafe, or an option of its driver is invalid."""


class InvalidCommand(DriverError, ValueError):
    """A command that this robot can never execute: a bug of the sender."""


class InvalidRequest(DriverError, ValueError):
    """A request that this robot can never fulfil, such as a place for an unknown object."""


class LifecycleError(DriverError, RuntimeError):
    """A call out of order, such as reading a driver that is not open."""


class HandsNotClear(LifecycleError):
    """Motion was requested after human help, before hands were confirmed clear."""


class FaultLatched(DriverError, RuntimeError):
    """The robot is stopped until an operator clears the fault by its name."""


class StaleState(DriverError, RuntimeError):
    """The newest measurement is older than the caller accepts."""


class LinkLost(DriverError, ConnectionError):
    """A remote robot does not answer in time, or its host was restarted."""


class LeaseRefused(DriverError, RuntimeError):
    """Another client has the lease of a remote robot, or the lease of this client has ended."""
