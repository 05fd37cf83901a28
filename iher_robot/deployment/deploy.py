"""Deploy a policy on a robot: the application behind ``iher-robot deploy``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from iher_robot.config.robot import choose_own_robot
from iher_robot.deployment.log import EpisodeRecord
from iher_robot.deployment.robot_checks import check_speed
from iher_robot.deployment.session import Deployment
from iher_robot.env.operator import Ask, Operator
from iher_robot.errors import UserError
from iher_robot.evaluation.compatibility import load_trained_policy
from iher_robot.evaluation.evaluate import rate_with_interval
from iher_robot.storage.robot_time import RobotTime

Echo = Callable[[str], None]


def _print(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


@dataclass(frozen=True)
class DeployResult:
    """Result of a deployment.

    Attributes:
        task: The task.
        environment: Name of the robot.
        episodes: Record of each episode; empty after a dry run.
        control_period_s: Duration of a control tick, s.
        warnings: Accepted differences between the policy's robot and this one.
        directory: Folder of the log; None after a dry run.
    """

    task: str
    environment: str
    episodes: tuple[EpisodeRecord, ...]
    control_period_s: float
    warnings: tuple[str, ...]
    directory: Path | None

    @property
    def successes(self) -> int:
        """Successful episodes; the operator's label overrides the task's result."""
        return sum(record.success for record in self.episodes)

    @property
    def aborted(self) -> int:
        """Episodes that ended early."""
        return sum(record.aborted for record in self.episodes)

    @property
    def ticks(self) -> int:
        """Control ticks of motion, without resets."""
        return sum(record.ticks for record in self.episodes)

    @property
    def robot_minutes(self) -> float:
        """Robot minutes of motion, without resets."""
        return RobotTime(self.ticks, self.control_period_s).minutes

    def summary(self) -> str:
        """The result in a few lines."""
        if self.directory is None:
            return "dry run: nothing has moved"
        count = len(self.episodes)
        done = (
            f"{self.task} on {self.environment}: {self.successes} of {count} episodes succeeded, "
            f"{rate_with_interval(self.successes, count)}, in {self.robot_minutes:.2f} robot "
            "minutes of motion"
        )
        lines = [done]
        if any(record.operator_success is not None for record in self.episodes):
            task_successes = sum(record.task_success for record in self.episodes)
            lines.append(f"labels  {task_successes} of {count} succeeded according to the task")
        if self.aborted:
            lines.append(f"aborted {self.aborted} of {count}, counted as failures")
        lines.append(f"log     {self.directory}: done, {count} episodes, {self.ticks} ticks")
        return "\n".join(lines)


def deploy(
    policy: Path,
    *,
    driver: str | None = None,
    robot: str | None = None,
    connect: Sequence[str] = (),
    task: str | None = None,
    episodes: int = 10,
    speed: float = 0.25,
    seed: int = 0,
    dry_run: bool = False,
    yes: bool = False,
    label: bool = False,
    out: Path | None = None,
    accept_body: bool = False,
    accept_interface: bool = False,
    ask: Ask | None = None,
    echo: Echo = _print,
) -> DeployResult:
    """Check, confirm, and run a policy on a robot; the robot is left held and disarmed.

    Episodes have more ticks at lower speed. Success is evaluated at the last step.

    Args:
        policy: The policy file.
        driver: Name of the robot driver; by default that of the robot's file, or ``zenoh``.
        robot: Name of a robot, or the path of a YAML file. With neither driver nor robot:
            ``robot.yaml`` in the working directory if it exists, else ``fetch`` on the network.
        connect: Endpoints of a robot on the network; if empty, those of its file, or this machine.
        task: Expected task of the policy; None for any.
        episodes: Number of episodes.
        speed: Share of full speed, above 0 and up to 1.
        seed: Seed of starts and goals; ``evaluate`` with the same seed has the same ones.
        dry_run: Check and print; nothing moves.
        yes: Start without confirmation.
        label: Ask the operator after each episode whether it succeeded.
        out: Folder to create for the log; by default a new one under ``deployments``.
        accept_body: Run a policy that was trained on another body.
        accept_interface: Run a policy for another interface, on a simulated robot.
        ask: Asks the operator; the terminal by default.
        echo: Prints a line; to standard output by default.

    Returns:
        The result.

    Raises:
        UserError: Bad input, or a robot that may not start or cannot continue; the message
            summarises the log.
        DriverError: The robot cannot be reached; nothing has moved.
    """
    operator = Operator(ask)
    _check_numbers(episodes=episodes, speed=speed, seed=seed)
    if not (dry_run or operator.present):
        _check_unattended(yes=yes, label=label)
    deployment = Deployment(
        trained=load_trained_policy(policy, task),
        robot=choose_own_robot(driver, robot, connect),
        operator=operator,
        echo=echo,
        episodes=episodes,
        speed=speed,
        seed=seed,
        yes=yes,
        label=label,
    )
    with deployment.connected() as env:
        plan = deployment.plan(env, accept_body=accept_body, accept_interface=accept_interface)
        echo(plan.text())
        plan.require_no_refusal()
        log = None
        if not dry_run:
            deployment.require_start()
            log = deployment.run(env, plan, out)
    return DeployResult(
        task=deployment.trained.task.name,
        environment=deployment.robot.title,
        episodes=() if log is None else tuple(log.episodes),
        control_period_s=plan.control_period_s,
        warnings=plan.warnings,
        directory=None if log is None else log.path,
    )


def _check_numbers(*, episodes: int, speed: float, seed: int) -> None:
    if episodes < 1:
        raise UserError(f"episodes is {episodes}, allowed: 1 or more")
    if seed < 0:
        raise UserError(f"seed is {seed}, allowed: 0 or more")
    check_speed(speed)


def _check_unattended(*, yes: bool, label: bool) -> None:
    if not yes:
        raise UserError(
            "there is no terminal to confirm the start; use one, or --yes, or --dry-run to check "
            "only"
        )
    if label:
        raise UserError("there is no terminal for labels; leave out --label")
