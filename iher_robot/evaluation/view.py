"""Watch a task in the simulator's window: the application behind ``iher-robot view``."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from drivers import Clock, MonotonicClock
from drivers.rendering import Viewable
from iher_robot.config.robot import choose_robot
from iher_robot.env.goal_env import EpisodeAborted, GoalRobotEnv
from iher_robot.errors import UserError
from iher_robot.evaluation.compatibility import Actor, check_fit, load_actor
from iher_robot.learning.goal_model import REAL
from iher_robot.rollout.episode import Stream, choose_action, episode_seed

_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")


@dataclass(frozen=True)
class ViewResult:
    """What was shown.

    Attributes:
        episodes: Episodes shown to their end.
        successes: Those whose last step met the goal.
        warnings: What differs between the policy's robot and this one.
    """

    episodes: int
    successes: int
    warnings: tuple[str, ...]

    def summary(self) -> str:
        """The result in a few lines."""
        lines = [f"warning: {warning}" for warning in self.warnings]
        shown = "1 episode" if self.episodes == 1 else f"{self.episodes} episodes"
        lines.append(f"{shown} shown, {self.successes} ended at the goal")
        return "\n".join(lines)


class Pace:
    """Keeps a simulation at the speed of real time.

    Args:
        period_ns: Time of one control tick.
        clock: Whose time is kept.
    """

    def __init__(self, period_ns: int, clock: Clock) -> None:
        self._period_ns = period_ns
        self._clock = clock
        self._due_ns = clock.now_ns()

    def wait(self) -> None:
        """Wait until the next tick is due. Time that was lost is not caught up in a hurry."""
        self._due_ns = max(self._due_ns + self._period_ns, self._clock.now_ns())
        self._clock.sleep_until_ns(self._due_ns)


def view(
    *,
    task: str | None = None,
    driver: str | None = None,
    robot: str | None = None,
    policy: Path | None = None,
    seed: int = 0,
    episodes: int | None = None,
    accept_interface: bool = False,
    clock: Clock | None = None,
) -> ViewResult:
    """Show episodes in a window in real time, until it is closed.

    Args:
        task: Name of the task; the policy's where None.
        driver: Name of the robot driver, of a simulated robot; by default what the robot's file
            names, or ``mujoco``.
        robot: Name of a robot, or the path of a YAML file; the driver's default where None.
        policy: The policy that acts; without one the robot holds still.
        seed: Decides starts and goals; those of ``evaluate`` with the same seed.
        episodes: Stop after this many; None shows them until the window is closed.
        accept_interface: Run a policy that was trained for another interface all the same.
        clock: What keeps real time; the machine's own by default.

    Returns:
        What was shown.

    Raises:
        UserError: There is no display, or bad input, or a policy that does not fit the robot.
        CannotRender: No window opens here.
    """
    if not any(map(os.environ.get, _DISPLAYS)):
        raise UserError(
            f"there is no display for a window ({' and '.join(_DISPLAYS)} are not set); film a "
            "policy instead with iher-robot evaluate --video FILE"
        )
    if episodes is not None and episodes < 1:
        raise UserError(f"episodes is {episodes}, allowed: 1 or more")
    if seed < 0:
        raise UserError(f"seed is {seed}, allowed: 0 or more")
    if task is None and policy is None:
        raise UserError("no task given; name one with --task, or a policy with --policy")
    actor = None if policy is None else load_actor(policy, task)
    name = task if actor is None else actor.task.name
    assert name is not None
    with choose_robot(driver, robot).make_env(name) as env:
        window = _window(env)
        warnings: tuple[str, ...] = ()
        if actor is not None:
            warnings = check_fit(actor, env, accept_interface=accept_interface)
        pace = Pace(env.robot_spec.control_period_ns, clock or MonotonicClock())
        shown = successes = 0
        while episodes is None or shown < episodes:
            success = _show_episode(
                env, actor, window, pace, episode_seed(seed, Stream.FINAL_EVALUATION, shown)
            )
            if success is None:
                break
            shown += 1
            successes += success
    return ViewResult(shown, successes, warnings)


def _window(env: GoalRobotEnv) -> Viewable:
    spec = env.robot_spec
    if spec.physical:
        raise UserError(f"{spec.name} is physical and view would move it; use a simulated robot")
    if not isinstance(env.driver, Viewable):
        raise UserError(f"driver {spec.name} opens no window; use driver mujoco")
    return env.driver


def _show_episode(
    env: GoalRobotEnv, actor: Actor | None, window: Viewable, pace: Pace, seed: int
) -> bool | None:
    """Show one episode; return whether it ended at the goal, None if the window was closed."""
    observation, _ = env.reset(seed=seed)
    goal = observation["desired_goal"]
    reached = env.task.is_success(observation["achieved_goal"], goal)
    if actor is None:
        env.hold()
    for _ in range(env.episode_ticks):
        if not window.show(goal, reached):
            return None
        pace.wait()
        if actor is None:
            env.driver.advance()  # without a command the tick is held
            continue
        action = choose_action(actor.policy, observation, REAL)[0].numpy()
        try:
            observation, _, _, _, info = env.step(action)
        except EpisodeAborted:
            return False
        reached = bool(info["is_success"])
    return reached if window.show(goal, reached) else None
