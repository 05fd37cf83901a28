"""Setup of a training run: robot, simulators for evaluation, learner and budget."""

from __future__ import annotations

import datetime
import math
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial

import torch

from iher_robot.config.device import pick_device, prepare_torch
from iher_robot.config.run import RunConfig
from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.errors import UserError
from iher_robot.evaluation.success_rate import RunSeeds, run_simulated
from iher_robot.learning.goal_model import Shapes
from iher_robot.learning.learner import Learner
from iher_robot.learning.networks.data_parallel import ALONE, Peers
from iher_robot.rollout.simulators.pool import SimulatorPool
from iher_robot.storage.robot_time import RobotTime
from iher_robot.training.learners.process_group import PeerGroup
from iher_robot.training.learners.torchrun import read_torchrun_rank
from tasks import GoalTask

CPU = torch.device("cpu")


@dataclass(frozen=True)
class TrainingSetup:
    """Robot, simulators and learner of a run.

    Attributes:
        config: Settings of the run.
        env: The robot.
        simulator: Where the policy is evaluated free of charge; None where the robot is physical,
            or another driver with the same options would move the same one.
        pool: Several simulators in parallel; None where one is enough.
        learner: The learner; in an asynchronous run the copy that acts, on the CPU.
        budget: The configured budget.
        group: Processes of ``torchrun`` that learn together; None where this one learns alone.
    """

    config: RunConfig
    env: GoalRobotEnv
    simulator: GoalRobotEnv | None
    pool: SimulatorPool | None
    learner: Learner
    budget: RobotTime
    group: PeerGroup | None = None

    def describe_budget(self, total: RobotTime, spent: RobotTime) -> str:
        """Describe what the budget means for the robot, in one sentence.

        Args:
            total: Motion that the run may spend, grants included.
            spent: Motion that it has spent.
        """
        per_episode = self.env.task.episode_ticks
        left = total.minus(spent)
        episodes = math.ceil(left.ticks / per_episode)
        period_ms = left.control_period_s * 1e3
        place = (
            "on a simulator of its own, free of charge"
            if self.simulator is not None
            else "on the robot, on an account of its own"
        )
        evaluations = self._evaluations(episodes)
        evaluated = evaluations * self.evaluation_episodes
        what = f"{left.minutes:.4g} robot minutes"
        if spent.ticks:
            what += f" of {total.minutes:.4g} are left, which"
        sentence = (
            f"{what} are {left.ticks:,} ticks of {period_ms:g} ms: {episodes:,} episodes of up to "
            f"{per_episode}, each with a reset; "
            f"evaluation runs {place}, {self.evaluation_episodes:,} episodes each time, about "
            f"{evaluated:,} in all"
        )
        if not self.env.driver.paces_itself:
            return sentence
        motion = _wall_time(left.seconds)
        evaluation = _wall_time(left.with_ticks(evaluated * per_episode).seconds)
        return (
            f"{sentence}; the robot moves in real time: about {motion} for the budget and "
            f"{evaluation} for evaluation, resets and learning not counted"
        )

    @property
    def run_simulated(self) -> RunSeeds | None:
        """Runs episodes free of charge; None without a simulator."""
        return None if self.simulator is None else seeds_runner(self.simulator, self.pool)

    @property
    def evaluation_episodes(self) -> int:
        """Episodes of one evaluation."""
        settings = self.config.evaluation
        return settings.robot_episodes if self.simulator is None else settings.episodes

    def _evaluations(self, episodes: int) -> int:
        """How often a run that spends its budget in whole episodes is evaluated."""
        epochs = math.ceil(episodes / self.config.learner.schedule.real_episodes)
        return math.ceil(epochs / self.config.evaluation.every_epochs)  # the last one always is


@contextmanager
def open_training_setup(config: RunConfig) -> Iterator[TrainingSetup]:
    """Make robot, simulators and learner; the robot is held and disarmed in the end.

    Args:
        config: Settings of the run.

    Yields:
        The setup.

    Raises:
        UserError: A setting that this machine, this robot or ``torchrun`` cannot meet.
    """
    group = _make_group(config)
    device = pick_device(config.device)
    prepare_torch(config)
    with ExitStack() as stack:
        env = stack.enter_context(config.chosen_robot.make_env(config.task))
        simulator = None
        if not (env.driver.spec.physical or env.driver.exclusive):
            simulator = stack.enter_context(config.chosen_robot.make_env(config.task))
        pool = open_pool(config, env, stack)
        learner = make_learner(
            config, env.task, CPU if config.asynchronous else device, group or ALONE
        )
        budget = RobotTime.from_minutes(config.budget_minutes, env.driver.spec.control_period_s)
        yield TrainingSetup(config, env, simulator, pool, learner, budget, group)


def _make_group(config: RunConfig) -> PeerGroup | None:
    rank = read_torchrun_rank()
    if rank is None:
        return None
    if rank.rank:
        raise UserError(
            f"this is process {rank.rank} of torchrun, which only learns, and has no robot; start "
            "the command itself: torchrun ... -m iher_robot train ..."
        )
    if config.asynchronous:
        raise UserError(
            "with --async one process learns while the robot moves, with torchrun several learn "
            "in turn with it; leave out one of the two"
        )
    return PeerGroup(rank)


def open_pool(config: RunConfig, env: GoalRobotEnv, stack: ExitStack) -> SimulatorPool | None:
    """Make the pool of simulators, if there is more than one.

    Args:
        config: Settings of the run.
        env: Its robot.
        stack: Closes them.

    Raises:
        UserError: The robot is no simulated one of this program, of which there can be several.
    """
    if config.simulators == 1:
        return None
    driver = env.driver
    if driver.spec.physical or driver.exclusive or driver.paces_itself:
        raise UserError(
            f"simulators is {config.simulators}, but {config.chosen_robot.title} is one robot "
            "that moves in real time, allowed: 1; leave it out, or choose a simulated robot with "
            "--driver mujoco"
        )
    return stack.enter_context(SimulatorPool(config, env.task.episode_ticks))


def seeds_runner(simulator: GoalRobotEnv, pool: SimulatorPool | None) -> RunSeeds:
    """Return what runs uncharged episodes.

    Args:
        simulator: Runs them one after the other,
        pool: or, where there is one, in parallel.
    """
    return partial(run_simulated, simulator) if pool is None else pool.run


def make_learner(
    config: RunConfig, task: GoalTask, device: torch.device, peers: Peers = ALONE
) -> Learner:
    """Make the learner of a run.

    Args:
        config: Settings of the run.
        task: The task, bound to the robot.
        device: Where replay, models and policy live.
        peers: Learners that share every batch with it.

    Raises:
        UserError: A setting asks for what the task does not declare, or for batches that cannot
            be shared.
    """
    symmetry = task.symmetry(rough=config.learner.symmetry.rough)
    shapes = Shapes(
        obs_dim=task.layout.obs_dim,
        goal_dim=task.goal_dim,
        action_dim=len(task.spec.action.names),
        episode_ticks=task.episode_ticks,
        goal_entries=task.goal_model.achieved_entries,
        shifted_entries=() if symmetry is None else symmetry.shifted,
    )
    try:
        return Learner(
            shapes,
            task.goal_model,
            config.learner,
            seed=config.seed,
            device=device,
            symmetry=symmetry,
            contact_model=task.contact_model,
            peers=peers,
        )
    except ValueError as error:
        raise UserError(f"task {config.task!r}: {error}") from error


def _wall_time(seconds: float) -> str:
    return str(datetime.timedelta(seconds=round(seconds)))
