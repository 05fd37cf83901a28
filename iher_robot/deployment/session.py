"""The episodes of a policy on a robot, and what is said of whatever ends them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from drivers import DriverError
from drivers.closing import Closing
from iher_robot.config.robot import ChosenRobot
from iher_robot.deployment.episode import DeploymentRecorder, run_deployed_episode
from iher_robot.deployment.log import (
    DeploymentLog,
    EpisodeRecord,
    default_deployment_path,
    file_digest,
)
from iher_robot.deployment.preflight import DeploymentPlan, deployed_ticks, fault_sentence
from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.env.operator import Operator
from iher_robot.errors import UserError
from iher_robot.evaluation.compatibility import TrainedPolicy
from iher_robot.rollout.episode import Stream, episode_seed
from iher_robot.rollout.timing import IdleMeter
from iher_robot.storage.episode import EpisodeHeader
from iher_robot.storage.episode_store import EpisodeStore
from iher_robot.storage.interface import keep_interface
from iher_robot.storage.ledger import Ledger
from iher_robot.storage.provenance import collect_provenance


class KeptEpisodes(Closing):
    """Data and accounts of a deployment, in its folder, as a run has them.

    Args:
        path: The folder.
        env: The robot.
    """

    def __init__(self, path: Path, env: GoalRobotEnv) -> None:
        directory = path / "episodes"
        keep_interface(directory, env.policy_interface())
        self._env = env
        self._ledger = Ledger(path / "ledger.sqlite")
        self._store = EpisodeStore(directory, durable_ticks=True)
        self.idle = IdleMeter(env.driver, self._ledger)

    def recorder(self, seed: int, ticks: int) -> DeploymentRecorder:
        """What keeps and counts the ticks of the next episode.

        Args:
            seed: Decides start and goal.
            ticks: Most ticks that it will have.
        """
        self.idle.end()
        return DeploymentRecorder(
            self._env,
            self._store,
            partial(self._ledger.reserve, "deployment", ticks, counted=True),
            self._ledger,
            lambda source, entry: EpisodeHeader(0, source, "deployment", seed, entry),
        )

    def close(self) -> None:
        """Write down what is open; closing twice does nothing."""
        self.idle.end()
        self._store.close()
        self._ledger.close()


@dataclass
class Deployment:
    """A policy, a robot and an operator.

    Attributes:
        trained: The policy.
        robot: The robot.
        operator: Who confirms, helps and labels.
        say: Prints a line.
        episodes: How many episodes.
        speed: Share of full speed, in (0, 1].
        seed: Decides starts and goals.
        yes: Never ask whether to start or to go on.
        label: Ask after each episode whether it succeeded.
        log: What was logged; None before anything moves.
    """

    trained: TrainedPolicy
    robot: ChosenRobot
    operator: Operator
    say: Callable[[str], None]
    episodes: int
    speed: float
    seed: int
    yes: bool
    label: bool
    log: DeploymentLog | None = None

    @contextmanager
    def connected(self) -> Iterator[GoalRobotEnv]:
        """Make the robot, slow, and say of what ends it early what is in the log.

        Yields:
            The robot, not yet connected; it is left held, disarmed and disconnected.

        Raises:
            UserError: Bad input, or a robot that could not go on.
            DriverError: A robot that cannot be reached; nothing has moved.
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

    def require_start(self) -> None:
        """Raise `UserError` unless somebody said that it may start."""
        if not self.yes and not self.operator.confirms("Start?"):
            raise UserError("not confirmed; nothing has moved")

    def run(self, env: GoalRobotEnv, plan: DeploymentPlan, out: Path | None) -> DeploymentLog:
        """Run the episodes.

        Args:
            env: The robot, open.
            plan: What was checked, for the log.
            out: Folder to make for the log; by default a new one under ``deployments``.

        Returns:
            What happened.

        Raises:
            UserError: The robot could not go on, or the log cannot be written.
            DriverError: The robot was lost.
        """
        path = out or default_deployment_path(self.trained.task.name)
        ticks = deployed_ticks(env.episode_ticks, self.speed)
        with ExitStack() as stack:
            self.log = stack.enter_context(DeploymentLog.create(path, self._header(env, plan)))
            kept = stack.enter_context(KeptEpisodes(path, env))
            for index in range(self.episodes):
                seed = episode_seed(self.seed, Stream.FINAL_EVALUATION, index)
                recorder = kept.recorder(seed, ticks)
                record = run_deployed_episode(
                    env, self.trained, self.log, recorder, seed=seed, ticks=ticks
                )
                kept.idle.begin()
                self._judge(record)
                fault = fault_sentence(env.driver)
                if fault is not None:
                    raise UserError(fault)
                last = index + 1 == self.episodes
                if record.aborted and not (last or self.yes or self.operator.confirms("Go on?")):
                    break
            return self.log

    def _judge(self, record: EpisodeRecord) -> None:
        if self.label and not record.aborted:
            record.operator_success = self.operator.label(record.task_success)
            if record.operator_success is not None:
                record.success = record.operator_success
        outcome = "success" if record.success else "failure"
        if record.aborted:
            outcome = record.ended
        self.say(f"episode {record.episode} of {self.episodes}: {outcome}, {record.ticks} ticks")

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
