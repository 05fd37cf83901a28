"""What was measured of a robot, in words, and what is wrong with it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from drivers import Mode, RobotSpec, RobotState
from drivers.remote import LinkQuality
from drivers.remote.state_stream import StateStream
from drivers.remote.status import HostStatus
from iher_robot.deployment.robot_checks import (
    joints_outside,
    latched_sentence,
    metres_from_home,
    not_home_sentence,
)
from iher_robot.version import __version__

_SLOW_SHARE = 0.5
"""Of a control period: what takes longer leaves too little time for everything else."""


@dataclass(frozen=True)
class Remote:
    """A robot behind a host.

    Attributes:
        status: What the host says.
        link: Round trips to it.
        states: Its states as they arrived.
        overruns: Ticks that ended a whole period late while it was measured.
    """

    status: HostStatus
    link: LinkQuality
    states: StateStream
    overruns: int


@dataclass(frozen=True)
class Examination:
    """What was measured of a robot.

    Attributes:
        spec: Its description.
        state: The newest measurement, None where there is none.
        now_ns: When that was received, on the clock of its stamps.
        homed: Whether the robot was just brought home.
        fault: Name of the latched fault and what happened, None without one.
        remote: What is known of its host, None for a robot of this process.
    """

    spec: RobotSpec
    state: RobotState | None
    now_ns: int
    homed: bool
    fault: tuple[str, str] | None
    remote: Remote | None = None

    def facts(self) -> dict[str, str]:
        """What it is and does, by name."""
        facts = _facts_of_spec(self.spec)
        if self.state is not None:
            away_mm = 1e3 * metres_from_home(self.spec, self.state)
            facts["now"] = f"{self.state.mode}, {away_mm:.1f} mm from home"
        facts["last fault"] = "none is latched" if self.fault is None else ": ".join(self.fault)
        if self.remote is None:
            return facts | {"link": "none, the driver runs in this process"}
        return facts | _facts_of_host(self.remote)

    def findings(self) -> list[str]:
        """What is wrong, each in a sentence with what to do."""
        name = self.spec.name
        found = list(_findings_of_body(self.spec, self.state, self.now_ns))
        if self.fault is not None:
            found.append(latched_sentence(name, *self.fault))
        elif self.state is not None and self.state.mode == Mode.STOPPED:
            found.append(f"{name} is stopped, and no fault is named; start its host again")
        if self.homed and self.state is not None:
            sentence = not_home_sentence(self.spec, self.state)
            found += [] if sentence is None else [sentence]
        if self.remote is not None:
            period_ms = 1e3 * self.spec.control_period_s
            found += _findings_of_link(self.remote, period_ms)
            found += _findings_of_host(self.remote, period_ms)
        return found


def _facts_of_spec(spec: RobotSpec) -> dict[str, str]:
    limits = spec.limits
    sides = ", ".join(
        f"{axis} {low:g} to {high:g}"
        for axis, low, high in zip(
            "xyz", limits.workspace.lower, limits.workspace.upper, strict=True
        )
    )
    enforced = "enforced" if spec.enforces_joint_limits else "NOT enforced"
    sources = (
        f"{name} from {source.source} in {source.frame!r}, stale after {source.max_age_s:g} s"
        for name, source in spec.objects.items()
    )
    return {
        "robot": f"{spec.name}, {'PHYSICAL' if spec.physical else 'simulated'}",
        "commands": f"{', '.join(spec.command_kinds)} every {1e3 * spec.control_period_s:g} ms, "
        f"held after {limits.watchdog_s:g} s without one",
        "limits": f"end effector {limits.max_ee_speed_m_s:g} m/s, fingers "
        f"{limits.gripper.max_speed_m_s:g} m/s, {len(limits.joints)} joints whose limits are "
        f"{enforced}",
        "workspace": f"{sides} m in {spec.frame!r}, {len(limits.keep_out)} kept-out boxes",
        "objects": "; ".join(sources) or "none",
        "home": f"end effector at {', '.join(f'{value:.3f}' for value in spec.home.ee_pos)} m",
        "digests": f"interface {spec.interface_digest[:12]}, body {spec.body_digest[:12]}",
    }


def _facts_of_host(remote: Remote) -> dict[str, str]:
    status, link, states = remote.status, remote.link, remote.states
    because = f", because: {status.disarmed_because}" * bool(status.disarmed_because)
    late = "not measured"
    if status.tick_late_p50_ms is not None and status.tick_late_p99_ms is not None:
        late = (
            f"late by {status.tick_late_p50_ms:.2f} ms (p50), {status.tick_late_p99_ms:.2f} (p99)"
        )
    return {
        "host": f"version {status.version or 'unknown'}, scene {status.scene or 'unknown'}",
        "gate": f"{'ARMED' if status.armed else 'disarmed'}, mode {status.mode!r}{because}",
        "used by": status.holder or "nobody",
        "refused": _counts(status.refusals),
        "cut": _counts(status.clips),
        "robot time": _minutes(status.total_ticks, status.control_period_s),
        "ticks": f"{late}, {status.tick_overruns} overruns since the host started",
        "link": f"round trip {link.p50_ms:.2f} ms (p50), {link.p99_ms:.2f} ms (p99), jitter "
        f"{link.jitter_ms:.2f} ms, {link.lost} of {link.count} lost",
        "states": f"{states.rate_hz:.1f} a second, jitter {states.jitter_ms:.2f} ms, "
        f"{states.lost} of {states.count + states.lost} lost",
    }


def _findings_of_body(spec: RobotSpec, state: RobotState | None, now_ns: int) -> Iterator[str]:
    if not spec.enforces_joint_limits:
        yield (
            f"nobody enforces the joint limits of {spec.name}; use it for benchmarks in simulation "
            "only"
        )
    if state is None:
        return
    for sentence in joints_outside(spec, state):
        yield f"{sentence}; check calibration and limits of {spec.name}"
    for name, source in spec.objects.items():
        pose = state.objects.get(name)
        if pose is None:
            yield f"nobody has seen {name} yet; start what publishes it as {source.source!r}"
        elif now_ns - pose.stamp_ns > source.max_age_s * 1e9:
            yield (
                f"{name} was seen {(now_ns - pose.stamp_ns) / 1e9:.1f} s ago, allowed: "
                f"{source.max_age_s:g} s; see that {source.source!r} runs and sees it"
            )


def _findings_of_link(remote: Remote, period_ms: float) -> Iterator[str]:
    link, states = remote.link, remote.states
    if not link.p99_ms <= _SLOW_SHARE * period_ms:  # nan, too
        yield (
            f"the link's p99 is {link.p99_ms:.1f} ms, allowed: half a control period of "
            f"{period_ms:g} ms; come nearer to the robot, use a cable, or free the processors"
        )
    if link.lost:
        yield (
            f"{link.lost} of {link.count} round trips were not answered; see what else the link "
            "and the host are busy with"
        )
    if states.malformed:
        yield (
            f"{states.malformed} messages were no states of this robot; see that its host has the "
            "same version, and that nobody else publishes as this robot"
        )
    if not states.count:
        yield "no state arrived; see that these credentials allow it, and that the host is not busy"
    elif states.lost:
        yield (
            f"{states.lost} of {states.count + states.lost} states were lost; see what else the "
            "link and this machine are busy with"
        )


def _findings_of_host(remote: Remote, period_ms: float) -> Iterator[str]:
    status = remote.status
    late_ms = status.tick_late_p99_ms
    if remote.overruns or (late_ms is not None and late_ms > _SLOW_SHARE * period_ms):
        yield (
            f"the host's ticks are late by {late_ms or 0.0:.1f} ms (p99) and {remote.overruns} "
            f"overran while it was measured, of {period_ms:g} ms each; free its processors, or "
            "let it have real-time scheduling"
        )
    if status.version and status.version != __version__:
        yield (
            f"the host has version {status.version}, here is {__version__}; install the same on "
            "both sides"
        )


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in sorted(counts.items())) or "none"


def _minutes(ticks: Mapping[str, int], period_s: float) -> str:
    minutes = {account: count * period_s / 60.0 for account, count in ticks.items()}
    parts = ", ".join(f"{account} {spent:.2f}" for account, spent in minutes.items() if spent)
    return f"{sum(minutes.values()):.2f} minutes in all" + f": {parts}" * bool(parts)
