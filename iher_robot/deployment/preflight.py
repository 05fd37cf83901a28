"""Deployment plan: the results of all checks, made before anything moves."""

from __future__ import annotations

from dataclasses import dataclass

from iher_robot.config.robot import ChosenRobot
from iher_robot.deployment import preflight_checks as checks
from iher_robot.deployment.preflight_checks import REFUSED, WARNING, Check
from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.errors import UserError
from iher_robot.evaluation.compatibility import TrainedPolicy


@dataclass(frozen=True)
class DeploymentPlan:
    """Plan of a deployment.

    Attributes:
        checks: Results of the checks, in the order of the table.
        control_period_s: Duration of a control tick, s.
    """

    checks: tuple[Check, ...]
    control_period_s: float

    @property
    def warnings(self) -> tuple[str, ...]:
        """Details of the checks that ended with a warning."""
        return tuple(check.detail for check in self.checks if check.verdict == WARNING)

    def text(self) -> str:
        """The plan as a table."""
        return "\n".join(
            f"{check.verdict:8} {check.name:11} {check.detail}" for check in self.checks
        )

    def require_no_refusal(self) -> None:
        """Raise `UserError` if a check refused the deployment."""
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
    """Connect to the robot, which stays held and disarmed, and run all checks.

    Args:
        trained: The policy.
        env: The robot.
        robot: The selected robot.
        episodes: Number of episodes.
        speed: Share of full speed.
        accept_body: Accept another body than the policy's.
        accept_interface: Accept another interface, on a simulated robot.

    Raises:
        DriverError: The robot cannot be reached.
    """
    spec = env.robot_spec
    if not env.driver.is_open:
        env.driver.open()
    results = (
        checks.check_policy(trained),
        checks.check_robot(robot, spec),
        *checks.check_interface(trained, env, accept_interface),
        checks.check_body(trained, spec, accept_body),
        *checks.check_limits(spec, speed),
        checks.check_fault(env.driver),
        checks.check_link(env.driver),
        *checks.check_state(env.driver),
        checks.check_episodes(env, episodes, speed),
    )
    return DeploymentPlan(results, spec.control_period_s)
