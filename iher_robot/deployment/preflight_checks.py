"""Individual checks before a deployment: policy, robot, interface, limits, fault, link, state."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from drivers import RobotDriver, RobotSpec, StaleState
from iher_robot.config.robot import ChosenRobot
from iher_robot.deployment.description import kind_text, position_text, workspace_text
from iher_robot.deployment.robot_checks import fault_sentence, joints_outside, metres_from_home
from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.errors import UserError
from iher_robot.evaluation.compatibility import (
    TrainedPolicy,
    body_differences,
    controller_warnings,
    interface_warnings,
)
from iher_robot.storage.robot_time import RobotTime

ACCEPT_BODY = "--accept-body"
OK, WARNING, REFUSED = "ok", "warning", "refused"


@dataclass(frozen=True)
class Check:
    """Result of a check.

    Attributes:
        name: Name of the check.
        detail: Its finding.
        verdict: ``"ok"``, ``"warning"`` or ``"refused"``.
    """

    name: str
    detail: str
    verdict: str = OK


class LinkQuality(Protocol):
    """Round trips between this machine and a robot's control loop."""

    @property
    def p50_ms(self) -> float:
        """Median."""
        ...

    @property
    def p99_ms(self) -> float:
        """99th percentile."""
        ...


@runtime_checkable
class MeasuresLink(Protocol):
    """A driver that can measure the link to its robot."""

    def measure_link(self) -> LinkQuality:
        """Measure round trips."""
        ...


def deployed_ticks(episode_ticks: int, speed: float) -> int:
    """Ticks of an episode at a share of full speed: the same path takes longer.

    Args:
        episode_ticks: Ticks at full speed.
        speed: Share of full speed, in (0, 1].
    """
    return math.ceil(episode_ticks / speed - 1e-9)


def check_policy(trained: TrainedPolicy) -> Check:
    """Name the policy, its task and its origin."""
    run, digest = trained.file.trained, trained.file.layout_digest[:12]
    origin = " ".join(str(run[key]) for key in ("algo", "driver", "robot") if run.get(key))
    return Check(
        "policy",
        f"{trained.path}: {trained.task.name}, observations {digest}"
        + f", trained by {origin}" * bool(origin),
    )


def check_robot(robot: ChosenRobot, spec: RobotSpec) -> Check:
    """Name the robot."""
    return Check("robot", f"{robot.title}: {spec.name}, {kind_text(spec)}")


def check_interface(
    trained: TrainedPolicy, env: GoalRobotEnv, accept_interface: bool
) -> list[Check]:
    """Compare the policy's interface and controller with the robot's."""
    try:
        warnings = interface_warnings(trained, env, accept_interface=accept_interface)
    except UserError as error:
        return [Check("interface", str(error), REFUSED)]
    checks = [Check("interface", sentence, WARNING) for sentence in warnings]
    if not checks:
        checks = [
            Check("interface", f"{env.robot_spec.interface_digest[:12]}, same as the policy's")
        ]
    found = controller_warnings(trained, env)
    if not found:
        kind = env.controller.settings["kind"]
        return [*checks, Check("controller", f"{kind}, same settings as the policy's")]
    return [*checks, *(Check("controller", sentence, WARNING) for sentence in found)]


def check_body(trained: TrainedPolicy, spec: RobotSpec, accepted: bool) -> Check:
    """Compare the body that the policy was trained on with the robot's."""
    found = body_differences(trained.file, spec)
    if not found:
        return Check("body", f"{spec.body_digest[:12]}, same as the policy's")
    sentence = f"the policy was trained on another body than {spec.name}: {'; '.join(found)}"
    if accepted:
        return Check("body", sentence, WARNING)
    return Check("body", f"{sentence}; if this is intended, add {ACCEPT_BODY}", REFUSED)


def check_limits(spec: RobotSpec, speed: float) -> list[Check]:
    """List the speed limits, joint limits and workspace."""
    limits = spec.limits
    joints = (f"{name} {speed * joint.max_velocity:.3g}" for name, joint in limits.joints.items())
    enforced = "" if spec.enforces_joint_limits else "; joint limits are NOT enforced"
    return [
        Check(
            "speed",
            f"{speed:.0%} of every limit: end effector up to "
            f"{speed * limits.max_ee_speed_m_s:.3g} m/s, fingers "
            f"{speed * limits.gripper.max_speed_m_s:.3g} m/s",
        ),
        Check("joints", f"up to (rad/s or m/s) {', '.join(joints) or 'none'}{enforced}"),
        Check("workspace", workspace_text(spec)),
    ]


def check_fault(driver: RobotDriver) -> Check:
    """Refuse a robot with a latched fault."""
    sentence = fault_sentence(driver)
    return Check("fault", sentence or "none is latched", REFUSED if sentence else OK)


def check_link(driver: RobotDriver) -> Check:
    """Measure the link; refuse round trips longer than a control period."""
    if not isinstance(driver, MeasuresLink):
        return Check("link", "none, the driver runs in this process")
    quality = driver.measure_link()
    period_ms = driver.spec.control_period_s * 1e3
    found = f"round trip {quality.p50_ms:.2f} ms (p50), {quality.p99_ms:.2f} ms (p99)"
    if not quality.p99_ms <= period_ms:  # true for nan
        return Check(
            "link",
            f"{found}, allowed: a control period of {period_ms:g} ms; move closer to the robot, or "
            "reduce the load of the network",
            REFUSED,
        )
    if quality.p99_ms > period_ms / 2.0:
        return Check(
            "link", f"{found}, more than half a control period of {period_ms:g} ms", WARNING
        )
    return Check("link", f"{found}, control period {period_ms:g} ms")


def check_state(driver: RobotDriver) -> Iterable[Check]:
    """Read the state: mode, distance from home, joints outside their ranges."""
    spec = driver.spec
    try:
        state = driver.read()
    except StaleState as error:  # a missing object pose is no reason not to go home
        return [Check("now", f"no complete state: {error}", WARNING)]
    away_m = metres_from_home(spec, state)
    position = position_text(state.ee_pos)
    checks = [
        Check("now", f"{state.mode}, end effector at {position} m, {away_m * 100:.1f} cm from home")
    ]
    outside = joints_outside(spec, state)
    if outside:
        checks.append(Check("joints now", "; ".join(outside), WARNING))
    return checks


def check_episodes(env: GoalRobotEnv, episodes: int, speed: float) -> Check:
    """List the number and length of the episodes in ticks and robot minutes."""
    period_s = env.robot_spec.control_period_s
    ticks = deployed_ticks(env.episode_ticks, speed)
    time = RobotTime(episodes * ticks, period_s)
    return Check(
        "episodes",
        f"{episodes} of {ticks} ticks of {period_s * 1e3:g} ms ({env.episode_ticks} at full "
        f"speed): {time}; the robot moves home before each",
    )
