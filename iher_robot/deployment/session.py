"""Deployment session: connect, confirm, run and log the episodes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from drivers import DriverError
from iher_robot.config.robot import ChosenRobot
from iher_robot.deployment.episode import run_deployed_episode
from iher_robot.deployment.log import (
    DeploymentLog,
    EpisodeRecord,
    default_deployment_path,
    file_digest,
)
from iher_robot.deployment.preflight import DeploymentPlan, make_plan
from iher_robot.deployment.preflight_checks import deployed_ticks
from iher_robot.deployment.robot_checks import fault_sentence
from iher_robot.deployment.store import DeploymentStore
from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.env.operator import Operator
from iher_robot.errors import UserError
from iher_robot.evaluation.compatibility import TrainedPolicy
from iher_robot.rollout.episode import Stream, episode_seed
from iher_robot.storage.provenance import collect_provenance


@dataclass
class Deployment:
    """Session of a policy, a robot and an operator.

    Attributes:
        trained: The policy.
        robot: The robot.
        operator: Confirms the start, helps with resets and labels episodes.
        echo: Prints a line.
        episodes: Number of episodes.
        speed: Share of full speed, in (0, 1].
        seed: Seed of starts and goals.
        yes: Start and continue without confirmation.
        label: Ask after each episode whether it succeeded.
        log: The log; None before anything moves.
    """

    trained: TrainedPolicy
    robot: ChosenRobot
    operator: Operator
    echo: Callable[[str], None]
    episodes: int
    speed: float
    seed: int
    yes: bool
    label: bool
    log: DeploymentLog | None = None

    @contextmanager
    def connected(self) -> Iterator[GoalRobotEnv]:
        """Create the robot with its speed limit; errors get a summary of the log.

        Yields:
            The robot, not yet connected; it is left held, disarmed and disconnected.

        Raises:
            UserError: Bad input, or a robot that cannot continue.
            DriverError: The robot cannot be reached; nothing has moved.
        """
        ask_human = self.operator.help if self.operator.present else None
        try:
            with self.robot.make_env(self.trained.task.name, ask_human=ask_human) as env:
                env.driver.limit_speed(self.speed)
                yield env
        except BaseException as error:
            if self.log is None:
                raise
            if isinstance(error, (DriverError, UserError)):
                raise UserError(f"{error}; {self.log.summary()}") from error
            held = "the robot is held and disarmed; " * isinstance(error, KeyboardInterrupt)
            error.add_note(held + self.log.summary())
            raise

    def plan(
        self, env: GoalRobotEnv, *, accept_body: bool, accept_interface: bool
    ) -> DeploymentPlan:
        """Run the checks, see `make_plan`."""
        return make_plan(
            self.trained,
            env,
            self.robot,
            episodes=self.episodes,
            speed=self.speed,
            accept_body=accept_body,
            accept_interface=accept_interface,
        )

    def require_start(self) -> None:
        """Raise `UserError` unless the operator confirms the start, or ``--yes`` was given."""
        if not self.yes and not self.operator.confirms("Start?"):
            raise UserError("not confirmed; nothing has moved")

    def run(self, env: GoalRobotEnv, plan: DeploymentPlan, out: Path | None) -> DeploymentLog:
        """Run the episodes.

        Args:
            env: The robot, open.
            plan: Results of the checks, for the log.
            out: Folder to create for the log; by default a new one under ``deployments``.

        Returns:
            The log.

        Raises:
            UserError: The robot cannot continue, or the log cannot be written.
            DriverError: The robot was lost.
        """
        path = out or default_deployment_path(self.trained.task.name)
        ticks = deployed_ticks(env.episode_ticks, self.speed)
        with ExitStack() as stack:
            self.log = stack.enter_context(DeploymentLog.create(path, self._header(env, plan)))
            store = stack.enter_context(DeploymentStore(path, env))
            for index in range(self.episodes):
                seed = episode_seed(self.seed, Stream.FINAL_EVALUATION, index)
                recorder = store.recorder(seed, ticks)
                record = run_deployed_episode(
                    env, self.trained, self.log, recorder, seed=seed, ticks=ticks
                )
                store.idle.begin()
                self._finish(record)
                fault = fault_sentence(env.driver)
                if fault is not None:
                    raise UserError(fault)
                last = index + 1 == self.episodes
                if record.aborted and not (last or self.yes or self.operator.confirms("Go on?")):
                    break
            return self.log

    def _finish(self, record: EpisodeRecord) -> None:
        """Ask for the operator's label and print the outcome."""
        if self.label and not record.aborted:
            record.operator_success = self.operator.label(record.task_success)
            if record.operator_success is not None:
                record.success = record.operator_success
        outcome = "success" if record.success else "failure"
        if record.aborted:
            outcome = record.ended
        self.echo(f"episode {record.episode} of {self.episodes}: {outcome}, {record.ticks} ticks")

    def _header(self, env: GoalRobotEnv, plan: DeploymentPlan) -> dict[str, Any]:
        robot, spec = self.robot, env.robot_spec
        return {
            "policy": str(self.trained.path),
            "policy_sha256": file_digest(self.trained.path, "policy file"),
            "task": self.trained.task.name,
            "robot": {"driver": robot.driver, "name": robot.name, "options": robot.options},
            "settings": {
                "episodes": self.episodes,
                "speed": self.speed,
                "seed": self.seed,
                "label": self.label,
            },
            "spec": spec.to_dict(),
            "interface_digest": spec.interface_digest,
            "body_digest": spec.body_digest,
            "controller": dict(env.controller.settings),
            "plan": [[check.verdict, check.name, check.detail] for check in plan.checks],
            "provenance": collect_provenance(sys.argv, self.seed, datetime.now(UTC)),
        }
