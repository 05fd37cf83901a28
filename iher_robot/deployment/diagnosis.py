"""Diagnosis of a robot: the examination's measurements, and its findings as sentences."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from drivers import Mode, RobotSpec, RobotState
from drivers.remote import LinkQuality
from drivers.remote.state_stream import StateStream
from drivers.remote.status import HostStatus
from iher_robot.deployment.description import host_facts, spec_facts
from iher_robot.deployment.robot_checks import (
    joints_outside,
    latched_sentence,
    metres_from_home,
    not_home_sentence,
)
from iher_robot.version import __version__

_SLOW_SHARE = 0.5
"""Share of a control period that a delay may take."""


@dataclass(frozen=True)
class Remote:
    """Measurements of a robot's host.

    Attributes:
        status: Status of the host.
        link: Round trips to it.
        states: Statistics of the received states.
        overruns: Ticks that ended a whole period late during the measurement.
    """

    status: HostStatus
    link: LinkQuality
    states: StateStream
    overruns: int


@dataclass(frozen=True)
class Examination:
    """Measurements of a robot.

    Attributes:
        spec: Its specification.
        state: The newest state, None without one.
        now_ns: Time of its receipt, on the clock of its stamps.
        homed: Whether the robot was just brought home.
        fault: Name and reason of the latched fault, None without one.
        remote: Measurements of its host, None for a driver in this process.
    """

    spec: RobotSpec
    state: RobotState | None
    now_ns: int
    homed: bool
    fault: tuple[str, str] | None
    remote: Remote | None = None

    def facts(self) -> dict[str, str]:
        """Specification and state, by name."""
        facts = spec_facts(self.spec)
        if self.state is not None:
            away_mm = 1e3 * metres_from_home(self.spec, self.state)
            facts["now"] = f"{self.state.mode}, {away_mm:.1f} mm from home"
        facts["last fault"] = "none is latched" if self.fault is None else ": ".join(self.fault)
        if self.remote is None:
            return facts | {"link": "none, the driver runs in this process"}
        remote = self.remote
        return facts | host_facts(remote.status, remote.link, remote.states)

    def findings(self) -> list[str]:
        """A sentence per problem, with what to do."""
        name = self.spec.name
        found = list(_findings_of_body(self.spec, self.state, self.now_ns))
        if self.fault is not None:
            found.append(latched_sentence(name, *self.fault))
        elif self.state is not None and self.state.mode == Mode.STOPPED:
            found.append(f"{name} is stopped without a named fault; restart its host")
        if self.homed and self.state is not None:
            sentence = not_home_sentence(self.spec, self.state)
            found += [sentence] if sentence else []
        if self.remote is not None:
            period_ms = 1e3 * self.spec.control_period_s
            found += _findings_of_link(self.remote, period_ms)
            found += _findings_of_host(self.remote, period_ms)
        return found


def _findings_of_body(spec: RobotSpec, state: RobotState | None, now_ns: int) -> Iterator[str]:
    if not spec.enforces_joint_limits:
        yield (
            f"the joint limits of {spec.name} are not enforced; use it for benchmarks in "
            "simulation only"
        )
    if state is None:
        return
    for sentence in joints_outside(spec, state):
        yield f"{sentence}; check calibration and limits of {spec.name}"
    for name, source in spec.objects.items():
        pose = state.objects.get(name)
        if pose is None:
            yield (
                f"no pose of {name} was received yet; start its publisher, source {source.source!r}"
            )
        elif now_ns - pose.stamp_ns > source.max_age_s * 1e9:
            yield (
                f"the pose of {name} is {(now_ns - pose.stamp_ns) / 1e9:.1f} s old, allowed: "
                f"{source.max_age_s:g} s; check that source {source.source!r} runs and sees it"
            )


def _findings_of_link(remote: Remote, period_ms: float) -> Iterator[str]:
    link, states = remote.link, remote.states
    if not link.p99_ms <= _SLOW_SHARE * period_ms:  # true for nan
        yield (
            f"the link's p99 is {link.p99_ms:.1f} ms, allowed: half a control period of "
            f"{period_ms:g} ms; move closer to the robot, use a cable, or reduce the CPU load"
        )
    if link.lost:
        yield (
            f"{link.lost} of {link.count} round trips were not answered; reduce the load of the "
            "link and the host"
        )
    if states.malformed:
        yield (
            f"{states.malformed} messages were not valid states of this robot; check that its host "
            "has the same version and that no other process publishes under this robot's name"
        )
    if not states.count:
        yield (
            "no state arrived; check that these credentials allow it and that the host is not "
            "overloaded"
        )
    elif states.lost:
        yield (
            f"{states.lost} of {states.count + states.lost} states were lost; reduce the load "
            "of the link and of this machine"
        )


def _findings_of_host(remote: Remote, period_ms: float) -> Iterator[str]:
    status = remote.status
    late_ms = status.tick_late_p99_ms
    if remote.overruns or (late_ms is not None and late_ms > _SLOW_SHARE * period_ms):
        yield (
            f"the host's ticks are late by {late_ms or 0.0:.1f} ms (p99) and {remote.overruns} "
            f"overran during the measurement, of {period_ms:g} ms each; reduce its CPU load, or "
            "allow it real-time scheduling"
        )
    if status.version and status.version != __version__:
        yield (
            f"the host has version {status.version}, this machine {__version__}; install the same "
            "version on both"
        )
