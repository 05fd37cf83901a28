"""What a deployment is about to do, and whether it may: checked before anything moves."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from drivers import RobotDriver, RobotSpec, StaleState
from iher_robot.config.robot import ChosenRobot
from iher_robot.deployment.robot_checks import joints_outside, latched_sentence, metres_from_home
from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.errors import UserError
from iher_robot.evaluation.compatibility import (
    TrainedPolicy,
    body_differences,
    controller_warnings,
    interface_warnings,
)

ACCEPT_BODY = "--accept-body"
OK, WARNING, REFUSED = "ok", "warning", "refused"


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
    """A driver whose robot is reached over a link."""

    def measure_link(self) -> LinkQuality:
        """Measure round trips."""
        ...


@dataclass(frozen=True)
class Check:
    """One thing that was looked at.

    Attributes:
        name: What.
        detail: What was found, in words.
        verdict: ``"ok"``, ``"warning"`` or ``"refused"``.
    """

    name: str
    detail: str
    verdict: str = OK


@dataclass(frozen=True)
class DeploymentPlan:
    """What is about to happen.

    Attributes:
        checks: In the order in which they are read.
        control_period_s: Time of a control tick.
    """

    checks: tuple[Check, ...]
    control_period_s: float

    @property
    def warnings(self) -> tuple[str, ...]:
        """What differs and is accepted."""
        return tuple(check.detail for check in self.checks if check.verdict == WARNING)

    def text(self) -> str:
        """The plan as a table."""
        return "\n".join(
            f"{check.verdict:8} {check.name:11} {check.detail}" for check in self.checks
        )

    def require_no_refusal(self) -> None:
        """Raise `UserError` if anything forbids the deployment."""
        refused = [check.detail for check in self.checks if check.verdict == REFUSED]
        if refused:
            raise UserError("; ".join(refused))


def make_plan(
    trained: TrainedPolicy,
    env: GoalRobotEnv,
    robot: ChosenRobot,
    *,
    episodes: int,
    speed: float,
    accept_body: bool,
    accept_interface: bool,
) -> DeploymentPlan:
    """Connect to the robot, which stays held and disarmed, and look at everything.

    Args:
        trained: The policy.
        env: The robot.
        robot: The same as it was chosen.
        episodes: How many episodes are asked for.
        speed: Share of full speed.
        accept_body: Whether another body than the policy's is accepted.
        accept_interface: Whether another interface is, on a simulated robot.

    Raises:
        DriverError: The robot cannot be reached.
    """
    spec = env.robot_spec
    if not env.driver.is_open:
        env.driver.open()
    checks = (
        _policy(trained),
        _robot(robot, spec),
        *_fit(trained, env, accept_interface),
        _body(trained, spec, accept_body),
        *_limits(spec, speed),
        _fault(env.driver),
        _link(env.driver),
        *_measurement(env.driver),
        _episodes(env, episodes, speed),
    )
    return DeploymentPlan(checks, spec.control_period_s)


def deployed_ticks(episode_ticks: int, speed: float) -> int:
    """Ticks of an episode at a share of full speed: the same way takes longer.

    Args:
        episode_ticks: Ticks at full speed.
        speed: The share, in (0, 1].
    """
    return math.ceil(episode_ticks / speed - 1e-9)


def _policy(trained: TrainedPolicy) -> Check:
    run, digest = trained.file.trained, trained.file.layout_digest[:12]
    origin = " ".join(str(run[key]) for key in ("algo", "driver", "robot") if run.get(key))
    return Check(
        "policy",
        f"{trained.path}: {trained.task.name}, observations {digest}"
        + f", trained by {origin}" * bool(origin),
    )


def _robot(robot: ChosenRobot, spec: RobotSpec) -> Check:
    kind = "PHYSICAL, it will really move" if spec.physical else "simulated"
    return Check("robot", f"{robot.title}: {spec.name}, {kind}")


def _fit(trained: TrainedPolicy, env: GoalRobotEnv, accept_interface: bool) -> list[Check]:
    try:
        warnings = interface_warnings(trained, env, accept_interface=accept_interface)
    except UserError as error:
        return [Check("interface", str(error), REFUSED)]
    checks = [Check("interface", sentence, WARNING) for sentence in warnings]
    if not checks:
        checks = [Check("interface", f"{env.robot_spec.interface_digest[:12]}, the policy's")]
    found = controller_warnings(trained, env)
    if not found:
        kind = env.controller.settings["kind"]
        return [*checks, Check("controller", f"{kind}, set as the policy's")]
    return [*checks, *(Check("controller", sentence, WARNING) for sentence in found)]


def _body(trained: TrainedPolicy, spec: RobotSpec, accepted: bool) -> Check:
    found = body_differences(trained.file, spec)
    if not found:
        return Check("body", f"{spec.body_digest[:12]}, the policy's")
    sentence = f"{spec.name} has another body than the policy was trained on: {'; '.join(found)}"
    if accepted:
        return Check("body", sentence, WARNING)
    return Check("body", f"{sentence}; if that is right, accept it with {ACCEPT_BODY}", REFUSED)


def _limits(spec: RobotSpec, speed: float) -> list[Check]:
    limits = spec.limits
    joints = (f"{name} {speed * joint.max_velocity:.3g}" for name, joint in limits.joints.items())
    low, high = limits.workspace.lower, limits.workspace.upper
    sides = ", ".join(
        f"{axis} {near:g} to {far:g}" for axis, near, far in zip("xyz", low, high, strict=True)
    )
    enforced = "" if spec.enforces_joint_limits else "; joint limits are NOT enforced"
    return [
        Check(
            "speed",
            f"{speed:.0%} of every limit: end effector up to "
            f"{speed * limits.max_ee_speed_m_s:.3g} m/s, fingers "
            f"{speed * limits.gripper.max_speed_m_s:.3g} m/s",
        ),
        Check("joints", f"up to (rad/s or m/s) {', '.join(joints) or 'none'}{enforced}"),
        Check("workspace", f"{sides} m in {spec.frame!r}, {len(limits.keep_out)} kept-out boxes"),
    ]


def fault_sentence(driver: RobotDriver) -> str | None:
    """Say what stopped a robot and how it is cleared; None without a latched fault."""
    fault = driver.fault
    if fault is None:
        return None
    return latched_sentence(driver.spec.name, fault.name, fault.reason)


def _fault(driver: RobotDriver) -> Check:
    sentence = fault_sentence(driver)
    return Check("fault", sentence or "none is latched", REFUSED if sentence else OK)


def _link(driver: RobotDriver) -> Check:
    if not isinstance(driver, MeasuresLink):
        return Check("link", "none, the driver runs in this process")
    quality = driver.measure_link()
    period_ms = driver.spec.control_period_s * 1e3
    found = f"round trip {quality.p50_ms:.2f} ms (p50), {quality.p99_ms:.2f} ms (p99)"
    if not quality.p99_ms <= period_ms:  # nan, too
        return Check(
            "link",
            f"{found}, allowed: a control period of {period_ms:g} ms; come nearer to the robot, or "
            "look for what loads the network",
            REFUSED,
        )
    if quality.p99_ms > period_ms / 2.0:
        return Check("link", f"{found}, more than half a period of {period_ms:g} ms", WARNING)
    return Check("link", f"{found}, control period {period_ms:g} ms")


def _measurement(driver: RobotDriver) -> Iterable[Check]:
    spec = driver.spec
    try:
        state = driver.read()
    except StaleState as error:  # an object out of sight is no reason not to go home
        return [Check("now", f"no whole measurement: {error}", WARNING)]
    away_m = metres_from_home(spec, state)
    place = ", ".join(f"{value:.3f}" for value in state.ee_pos)
    checks = [
        Check("now", f"{state.mode}, end effector at {place} m, {away_m * 100:.1f} cm from home")
    ]
    outside = joints_outside(spec, state)
    if outside:
        checks.append(Check("joints now", "; ".join(outside), WARNING))
    return checks


def _episodes(env: GoalRobotEnv, episodes: int, speed: float) -> Check:
    period_s = env.robot_spec.control_period_s
    ticks = deployed_ticks(env.episode_ticks, speed)
    minutes = episodes * ticks * period_s / 60.0
    return Check(
        "episodes",
        f"{episodes} of {ticks} ticks of {period_s * 1e3:g} ms ({env.episode_ticks} at full "
        f"speed): {minutes:.2f} robot minutes; before each the robot moves home",
    )
