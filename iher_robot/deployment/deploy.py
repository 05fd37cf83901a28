"""Run a policy on the configured robot: the application behind ``iher-robot deploy``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from iher_robot.config.robot import choose_own_robot
from iher_robot.deployment.log import EpisodeRecord
from iher_robot.deployment.preflight import make_plan
from iher_robot.deployment.session import Deployment
from iher_robot.env.operator import Ask, Operator
from iher_robot.errors import UserError
from iher_robot.evaluation.compatibility import load_trained_policy
from iher_robot.evaluation.evaluate import rate_with_interval

Echo = Callable[[str], None]


def _print(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


@dataclass(frozen=True)
class DeployResult:
    """What a policy did on a robot.

    Attributes:
        task: The task.
        environment: Where it ran.
        episodes: What became of each episode; none after a dry run.
        control_period_s: Time of a control tick.
        warnings: What differs between the policy's robot and this one, and was accepted.
        directory: The folder of the log; None after a dry run.
    """

    task: str
    environment: str
    episodes: tuple[EpisodeRecord, ...]
    control_period_s: float
    warnings: tuple[str, ...]
    directory: Path | None

    @property
    def successes(self) -> int:
        """Episodes that succeeded, the operator's judgement first."""
        return sum(record.success for record in self.episodes)

    @property
    def aborted(self) -> int:
        """Episodes that ended early."""
        return sum(record.aborted for record in self.episodes)

    @property
    def ticks(self) -> int:
        """Control ticks of motion, resets left out."""
        return sum(record.ticks for record in self.episodes)

    @property
    def robot_minutes(self) -> float:
        """Robot minutes of motion, resets left out."""
        return self.ticks * self.control_period_s / 60.0

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
            judged = sum(record.task_success for record in self.episodes)
            lines.append(f"labels  the task itself judged {judged} of {count} successful")
        if self.aborted:
            lines.append(f"aborted {self.aborted} of {count}, which count as failures")
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
    """Check, ask, and run a policy on a robot; the robot is left held and disarmed.

    An episode has the more ticks the slower the robot may be. Success counts at its last step.

    Args:
        policy: The policy file.
        driver: Name of the robot driver; by default what the robot's file names, or ``zenoh``.
        robot: Name of a robot, or the path of a YAML file. Where neither driver nor robot is
            given: ``robot.yaml`` in this folder if there is one, else ``fetch`` on the network.
        connect: Where to reach a robot on the network; what its file says, or this machine,
            where empty.
        task: The task that the policy is expected to be for; any where None.
        episodes: How many episodes.
        speed: Share of full speed, above 0 and up to 1.
        seed: Decides starts and goals; those of ``evaluate`` with the same seed.
        dry_run: Check and print, and move nothing.
        yes: Start without a question.
        label: Ask the operator after each episode whether it succeeded.
        out: Folder to make for the log; by default a new one under ``deployments``.
        accept_body: Run a policy that was trained on another body.
        accept_interface: Run one for another interface, on a simulated robot.
        ask: Asks the operator; the terminal by default.
        echo: Prints a line; to standard output by default.

    Returns:
        What the policy did.

    Raises:
        UserError: Bad input, or a robot that may not or could not go on; the message says what
            is in the log.
        DriverError: The robot cannot be reached; nothing has moved.
    """
    operator = Operator(ask)
    _check_input(episodes=episodes, speed=speed, seed=seed)
    if not (dry_run or operator.present):
        _require_script(yes=yes, label=label)
    deployment = Deployment(
        trained=load_trained_policy(policy, task),
        robot=choose_own_robot(driver, robot, connect),
        operator=operator,
        say=echo,
        episodes=episodes,
        speed=speed,
        seed=seed,
        yes=yes,
        label=label,
    )
    with deployment.connected() as env:
        plan = make_plan(
            deployment.trained,
            env,
            deployment.robot,
            episodes=episodes,
            speed=speed,
            accept_body=accept_body,
            accept_interface=accept_interface,
        )
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


def _check_input(*, episodes: int, speed: float, seed: int) -> None:
    if episodes < 1:
        raise UserError(f"episodes is {episodes}, allowed: 1 or more")
    if seed < 0:
        raise UserError(f"seed is {seed}, allowed: 0 or more")
    if not 0.0 < speed <= 1.0:
        raise UserError(f"speed is {speed}, allowed: above 0 and up to 1, a share of full speed")


def _require_script(*, yes: bool, label: bool) -> None:
    if not yes:
        raise UserError(
            "there is no terminal to ask whether to start; start it in one, or with --yes, or see "
            "what it would do with --dry-run"
        )
    if label:
        raise UserError("there is no terminal to ask for labels; leave out --label")
