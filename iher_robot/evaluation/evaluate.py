"""Evaluate a policy over fresh episodes: the application behind ``iher-robot evaluate``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from statistics import NormalDist

from iher_robot.config.robot import DEFAULT_DRIVER, ChosenRobot, choose_robot
from iher_robot.errors import UserError
from iher_robot.evaluation.compatibility import TrainedPolicy, check_fit, load_trained_policy
from iher_robot.evaluation.official import OFFICIAL_IDS, OfficialEnv
from iher_robot.evaluation.video import Film, film
from iher_robot.rollout.actor import PolicyActor
from iher_robot.rollout.episode import Stream, episode_seed, run_episode
from iher_robot.rollout.observer import EpisodeEnv
from iher_robot.rollout.recorder import EpisodeOutcome

FILMED_EPISODES = 10
"""Episodes of an evaluation that a film shows, the first ones."""

_OFFICIAL_ROBOT = (DEFAULT_DRIVER, "fetch-mocap")


def wilson_interval(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Interval of a binomial proportion, by the score test without a correction for continuity.

    Args:
        successes: Trials that succeeded, from 0 to `trials`.
        trials: At least 1.
        confidence: Coverage, of both sides together.

    Returns:
        Its two ends, within 0 and 1.

    Source:
        E. B. Wilson, "Probable inference, the law of succession, and statistical inference",
        Journal of the American Statistical Association 22 (1927), 209-212.
    """
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    rate, weight = successes / trials, z**2 / trials
    center = (rate + weight / 2) / (1 + weight)
    half = z / (1 + weight) * math.sqrt(rate * (1 - rate) / trials + weight / (4 * trials))
    # At the ends one side is exact, which the rounding of the formula would miss.
    low = center - half if successes else 0.0
    high = center + half if successes < trials else 1.0
    return low, high


def rate_with_interval(successes: int, episodes: int) -> str:
    """Write a success rate with its 95 % interval (Wilson).

    Args:
        successes: Episodes that succeeded.
        episodes: Episodes run, at least 1.
    """
    low, high = wilson_interval(successes, episodes)
    share = f"{successes / episodes:.0%}"
    return f"{share} (95 % interval {low:.0%} to {high:.0%})"


@dataclass(frozen=True)
class EvaluationResult:
    """Result of an evaluation.

    Attributes:
        task: The task.
        environment: The environment that it ran in.
        successes: Episodes whose last step met the goal.
        episodes: Episodes run.
        warnings: What differs between the policy's robot and this one.
        video: The film, if there is one.
    """

    task: str
    environment: str
    successes: int
    episodes: int
    warnings: tuple[str, ...]
    video: Path | None

    @property
    def success_rate(self) -> float:
        """Share of successful episodes."""
        return self.successes / self.episodes

    @property
    def rate(self) -> str:
        """The success rate with its 95 % interval (Wilson)."""
        return rate_with_interval(self.successes, self.episodes)

    def summary(self) -> str:
        """The result in a few lines."""
        lines = [f"warning: {warning}" for warning in self.warnings]
        lines.append(
            f"{self.task} in {self.environment}: {self.successes} of {self.episodes} episodes "
            f"succeeded, {self.rate}"
        )
        if self.video is not None:
            filmed = min(self.episodes, FILMED_EPISODES)
            shown = "the first episode" if filmed == 1 else f"the first {filmed} episodes"
            lines.append(f"video   {self.video}, {shown}")
        return "\n".join(lines)


def evaluate(
    policy: Path,
    *,
    episodes: int = 100,
    seed: int = 0,
    official: bool = False,
    driver: str | None = None,
    robot: str | None = None,
    connect: Sequence[str] = (),
    task: str | None = None,
    video: Path | None = None,
    accept_interface: bool = False,
) -> EvaluationResult:
    """Run a policy without noise over fresh episodes; success counts at the last step.

    Args:
        policy: The policy file.
        episodes: How many episodes.
        seed: Decides starts and goals, apart from those of any training run.
        official: Run in gymnasium-robotics' own environment instead of on a driver.
        driver: Name of the robot driver; by default what the robot's file names, or ``mujoco``.
        robot: Name of a robot, or the path of a YAML file; the driver's default where None.
        connect: Where to reach a robot on the network; what its file says where empty.
        task: The task that the policy is expected to be for; any where None.
        video: File to film the first episodes to.
        accept_interface: Run a policy that was trained for another interface anyway, on a
            simulated robot.

    Returns:
        The result.

    Raises:
        UserError: Bad input, or a policy that does not fit the robot.
    """
    if episodes < 1:
        raise UserError(f"episodes is {episodes}, allowed: 1 or more")
    if seed < 0:
        raise UserError(f"seed is {seed}, allowed: 0 or more")
    elsewhere = driver not in (None, DEFAULT_DRIVER) or connect
    if official and (elsewhere or robot is not None):
        named = f"driver is {driver!r}" if robot is None else f"robot is {robot!r}"
        if connect:
            named = f"--connect is {connect[0]!r}"
        raise UserError(
            f"{named}, but the official environment is gymnasium-robotics' own simulation; leave "
            "out --driver and --robot, or --official"
        )
    trained = load_trained_policy(policy, task)
    if official:
        return _evaluate_officially(trained, episodes=episodes, seed=seed, video=video)
    return evaluate_on(
        choose_robot(driver, robot, connect),
        trained,
        episodes=episodes,
        seed=seed,
        video=video,
        accept_interface=accept_interface,
    )


def evaluate_on(
    robot: ChosenRobot,
    trained: TrainedPolicy,
    *,
    episodes: int,
    seed: int,
    video: Path | None = None,
    accept_interface: bool = False,
) -> EvaluationResult:
    """Run a policy on a robot; see ``evaluate``.

    Args:
        robot: The robot.
        trained: The policy.
        episodes: How many episodes.
        seed: Decides starts and goals, apart from those of any training run.
        video: File to film the first episodes to.
        accept_interface: Run it on another interface anyway, on a simulated robot.

    Returns:
        The result.

    Raises:
        UserError: A robot that the policy does not fit, or a film that cannot be made.
    """
    with ExitStack() as stack:
        shots = None if video is None else stack.enter_context(film(video))
        env = stack.enter_context(robot.make_env(trained.task.name, _render_mode(video)))
        warnings = check_fit(trained, env, accept_interface=accept_interface)
        successes = _successes(env, trained, episodes, seed, shots)
    return EvaluationResult(trained.task.name, robot.title, successes, episodes, warnings, video)


def _evaluate_officially(
    trained: TrainedPolicy, *, episodes: int, seed: int, video: Path | None
) -> EvaluationResult:
    name = OFFICIAL_IDS[trained.task.name]
    # The official environment has no specification of its own; this robot is its equal.
    with choose_robot(*_OFFICIAL_ROBOT).make_env(trained.task.name) as equal:
        warnings = check_fit(trained, equal, accept_interface=True)
    with ExitStack() as stack:
        shots = None if video is None else stack.enter_context(film(video))
        env = stack.enter_context(closing(OfficialEnv(name, _render_mode(video))))
        successes = _successes(env, trained, episodes, seed, shots)
    return EvaluationResult(trained.task.name, name, successes, episodes, warnings, video)


def _render_mode(video: Path | None) -> str | None:
    return None if video is None else "rgb_array"


def _successes(
    env: EpisodeEnv, trained: TrainedPolicy, episodes: int, seed: int, shots: Film | None
) -> int:
    actor, successes = PolicyActor(trained.policy), 0
    for index in range(episodes):
        outcome = EpisodeOutcome()
        run_episode(
            env,
            actor,
            outcome,
            seed=episode_seed(seed, Stream.FINAL_EVALUATION, index),
            ticks=trained.task.episode_ticks,
            observers=[shots] if shots is not None and index < FILMED_EPISODES else [],
        )
        successes += outcome.success
    return successes
