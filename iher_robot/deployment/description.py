"""Description of a robot and its host for the operator: facts and short texts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from drivers import RobotSpec
from drivers.remote import LinkQuality
from drivers.remote.state_stream import StateStream
from drivers.remote.status import HostStatus
from iher_robot.storage.robot_time import RobotTime


def kind_text(spec: RobotSpec) -> str:
    """Whether a robot is physical, as a warning before it moves."""
    return "PHYSICAL, it will really move" if spec.physical else "simulated"


def position_text(position: Iterable[float]) -> str:
    """Coordinates with three decimals."""
    return ", ".join(f"{value:.3f}" for value in position)


def workspace_text(spec: RobotSpec) -> str:
    """Sides of the workspace, its frame and the number of keep-out boxes."""
    limits = spec.limits
    sides = ", ".join(
        f"{axis} {low:g} to {high:g}"
        for axis, low, high in zip(
            "xyz", limits.workspace.lower, limits.workspace.upper, strict=True
        )
    )
    return f"{sides} m in {spec.frame!r}, {len(limits.keep_out)} keep-out boxes"


def spec_facts(spec: RobotSpec) -> dict[str, str]:
    """Facts of a robot's specification, by name."""
    limits = spec.limits
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
        f"{limits.gripper.max_speed_m_s:g} m/s, {len(limits.joints)} joints with limits "
        f"{enforced}",
        "workspace": workspace_text(spec),
        "objects": "; ".join(sources) or "none",
        "home": f"end effector at {position_text(spec.home.ee_pos)} m",
        "digests": f"interface {spec.interface_digest[:12]}, body {spec.body_digest[:12]}",
    }


def host_facts(status: HostStatus, link: LinkQuality, states: StateStream) -> dict[str, str]:
    """Facts of a robot's host and of the link to it, by name."""
    because = f", because: {status.disarmed_because}" * bool(status.disarmed_because)
    late = "not measured"
    if status.tick_late_p50_ms is not None and status.tick_late_p99_ms is not None:
        late = (
            f"late by {status.tick_late_p50_ms:.2f} ms (p50), {status.tick_late_p99_ms:.2f} (p99)"
        )
    return {
        "host": f"version {status.version or 'unknown'}, scene {status.scene or 'unknown'}",
        "gate": f"{'ARMED' if status.armed else 'disarmed'}, mode {status.mode!r}{because}",
        "used by": status.holder or "no client",
        "refused": _counts(status.refusals),
        "clipped": _counts(status.clips),
        "robot time": _minutes(status.total_ticks, status.control_period_s),
        "ticks": f"{late}, {status.tick_overruns} overruns since the host started",
        "link": f"round trip {link.p50_ms:.2f} ms (p50), {link.p99_ms:.2f} ms (p99), jitter "
        f"{link.jitter_ms:.2f} ms, {link.lost} of {link.count} lost",
        "states": f"{states.rate_hz:.1f} a second, jitter {states.jitter_ms:.2f} ms, "
        f"{states.lost} of {states.count + states.lost} lost",
    }


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in sorted(counts.items())) or "none"


def _minutes(ticks: Mapping[str, int], period_s: float) -> str:
    minutes = {account: RobotTime(count, period_s).minutes for account, count in ticks.items()}
    parts = ", ".join(f"{account} {spent:.2f}" for account, spent in minutes.items() if spent)
    return f"{sum(minutes.values()):.2f} minutes in total" + f": {parts}" * bool(parts)
