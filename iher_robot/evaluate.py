"""Measure a policy over fresh episodes: the application behind ``iher-robot evaluate``."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing, redirect_stderr
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch
from scipy.stats import binomtest

from iher_robot.callable_module import make_module_callable
from iher_robot.collect import Stream, choose_action, episode_seed
from iher_robot.env import GoalRobotEnv, make_env
from iher_robot.errors import UserError
from iher_robot.learning.goal_model import REAL
from iher_robot.learning.policy import Policy
from iher_robot.policy_file import PolicyFile, check_task, load_policy
from iher_robot.video import film
from tasks import GoalTask, make_task

FILMED_EPISODES = 10
"""Episodes of an evaluation that a film shows, the first ones."""

_OFFICIAL = {
    "reach": "FetchReach-v4",
    "push": "FetchPush-v4",
    "pick_and_place": "FetchPickAndPlace-v4",
    "slide": "FetchSlide-v4",
}

AnyEnv = gym.Env[Any, Any]
Picture = Callable[[AnyEnv], None]


@dataclass(frozen=True)
class EvaluationResult:
    """What a policy did.

    Attributes:
        task: The task.
        environment: Where it ran.
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

    def summary(self) -> str:
        """The result in a few lines."""
        interval = binomtest(self.successes, self.episodes).proportion_ci(method="wilson")
        lines = [f"warning: {warning}" for warning in self.warnings]
        lines.append(
            f"{self.task} in {self.environment}: {self.successes} of {self.episodes} episodes "
            f"succeeded, {self.success_rate:.0%} "
            f"(95 % interval {interval.low:.0%} to {interval.high:.0%})"
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
    driver: str = "mujoco",
    task: str | None = None,
    video: Path | None = None,
) -> EvaluationResult:
    """Run a policy without noise over fresh episodes; success counts at the last step.

    Args:
        policy: The policy file.
        episodes: How many episodes.
        seed: Decides starts and goals, apart from those of any training run.
        official: Run in gymnasium-robotics' own environment instead of on a driver.
        driver: Name of the robot driver.
        task: The task that the policy is expected to be for; any where None.
        video: File to film the first episodes to.

    Returns:
        What the policy did.

    Raises:
        UserError: Bad input, or a policy that does not fit the robot.
    """
    if episodes < 1:
        raise UserError(f"episodes is {episodes}, allowed: 1 or more")
    if seed < 0:
        raise UserError(f"seed is {seed}, allowed: 0 or more")
    if official and driver != "mujoco":
        raise UserError(
            f"driver is {driver!r}, but the official environment is gymnasium-robotics' own "
            "simulation; leave out --driver or --official"
        )
    loaded = load_policy(policy)
    asked = make_task(loaded.task if task is None else task)
    check_task(loaded, asked.name, asked.layout.digest())
    actor = _actor(loaded, policy, asked)
    render_mode = None if video is None else "rgb_array"
    with ExitStack() as stack:
        picture = None if video is None else stack.enter_context(film(video))
        differing: tuple[str, ...] = ()
        env: AnyEnv
        if official:
            name = _OFFICIAL[loaded.task]
            env = stack.enter_context(closing(_official_env(name, render_mode)))
        else:
            name = driver
            robot = stack.enter_context(make_env(loaded.task, driver, render_mode=render_mode))
            differing = _warnings(loaded, robot)
            env = robot
        if env.action_space.shape != (actor.shapes.action_dim,):
            raise UserError(
                f"{policy} holds a policy of {actor.shapes.action_dim} action values, the robot "
                f"takes {env.action_space.shape}; train it again"
            )
        successes = 0
        for index in range(episodes):
            filmed = picture if index < FILMED_EPISODES else None
            successes += _episode(
                env,
                actor,
                seed=episode_seed(seed, Stream.FINAL_EVALUATION, index),
                ticks=asked.episode_ticks,
                picture=filmed,
            )
    return EvaluationResult(loaded.task, name, successes, episodes, differing, video)


def _actor(loaded: PolicyFile, path: Path, task: GoalTask) -> Policy:
    """Build the networks of a file whose seal says nothing of what its writer put in."""
    try:
        actor = Policy.from_snapshot(loaded.policy, device=torch.device("cpu"))
        observation = torch.zeros(1, task.layout.obs_dim)
        goal = torch.zeros(1, task.goal_dim)
        action = actor.act(observation, goal, torch.tensor([REAL]))
    except (
        ArithmeticError,
        AttributeError,
        KeyError,
        RuntimeError,
        TypeError,
        ValueError,
    ) as error:
        named = f"it has no {error}" if isinstance(error, KeyError) else str(error)
        reason = " ".join(named.split())
        raise UserError(f"{path} holds no policy that can act: {reason}; train it again") from error
    if not torch.isfinite(action).all():
        raise UserError(f"{path} holds no policy that can act: its actions are not finite")
    return actor


def _warnings(policy: PolicyFile, env: GoalRobotEnv) -> tuple[str, ...]:
    """Refuse another interface; name what differs between the bodies."""
    spec = env.driver.spec
    if policy.interface_digest != spec.interface_digest:
        raise UserError(
            f"the policy was trained for another interface than {spec.name} has, it differs in "
            f"{_changed(policy.spec, spec.interface())}; train one on this driver"
        )
    found = []
    if policy.body_digest != spec.body_digest:
        changed = _changed(policy.spec, spec.body())
        found.append(f"the policy was trained on another body, it differs in {changed}")
    if policy.controller != dict(env.controller.settings):
        changed = _changed(policy.controller, env.controller.settings)
        found.append(f"the policy was trained with another controller, it differs in {changed}")
    return tuple(found)


def _changed(saved: Mapping[str, object], present: Mapping[str, object]) -> str:
    names = [name for name, value in present.items() if saved.get(name, value) != value]
    return ", ".join(names) or "a setting that the policy does not name"


def _official_env(name: str, render_mode: str | None) -> AnyEnv:
    # Importing the package prints notices about environments that are not ours.
    with redirect_stderr(io.StringIO()):
        import gymnasium_robotics
    gym.register_envs(gymnasium_robotics)
    return gym.make(name, render_mode=render_mode)


def _episode(
    env: AnyEnv, policy: Policy, *, seed: int, ticks: int, picture: Picture | None
) -> bool:
    observation, _ = env.reset(seed=seed)
    info: dict[str, Any] = {"is_success": 0.0}
    for _ in range(ticks):
        if picture is not None:
            picture(env)
        action = choose_action(policy, observation, REAL)[0].numpy()
        observation, _, _, truncated, info = env.step(action)
        if truncated:
            break
    return bool(info["is_success"])


make_module_callable(__name__)
