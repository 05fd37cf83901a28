"""View episodes in the simulator's window: the application behind ``iher-robot view``."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers import Clock, MonotonicClock
from drivers.rendering import Viewable
from iher_robot.config.robot import choose_robot
from iher_robot.env.goal_env import GoalRobotEnv, Observation
from iher_robot.errors import UserError
from iher_robot.evaluation.compatibility import TrainedPolicy, check_fit, load_trained_policy
from iher_robot.rollout.actor import PolicyActor
from iher_robot.rollout.episode import Stream, episode_seed, run_episode
from iher_robot.rollout.observer import Action, EpisodeObserver, EpisodeStart, Transition
from iher_robot.rollout.recorder import EpisodeOutcome

_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")


@dataclass(frozen=True)
class ViewResult:
    """Result of a view.

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
        clock: Clock of real time.
    """

    def __init__(self, period_ns: int, clock: Clock) -> None:
        self._period_ns = period_ns
        self._clock = clock
        self._due_ns = clock.now_ns()

    def wait(self) -> None:
        """Wait until the next tick is due. Lost time is not caught up."""
        self._due_ns = max(self._due_ns + self._period_ns, self._clock.now_ns())
        self._clock.sleep_until_ns(self._due_ns)


class WindowClosed(Exception):
    """The user closed the window."""


class WindowObserver(EpisodeObserver):
    """Shows an episode in a window in real time.

    Args:
        window: The window.
        pace: Keeps real time.
    """

    def __init__(self, window: Viewable, pace: Pace) -> None:
        self._window = window
        self._pace = pace

    def start(self, start: EpisodeStart) -> None:
        """Show the start."""
        assert isinstance(start.env, GoalRobotEnv)
        goal, achieved = start.observation["desired_goal"], start.observation["achieved_goal"]
        self.show(goal, bool(start.env.task.is_success(achieved, goal)))

    def before_tick(self, observation: Observation, action: Action) -> None:  # noqa: ARG002
        """Wait until the tick is due."""
        self.wait()

    def after_tick(self, transition: Transition) -> None:
        """Show the robot after a tick."""
        self.show(transition.next_observation["desired_goal"], transition.success)

    def wait(self) -> None:
        """Wait until the next tick is due."""
        self._pace.wait()

    def show(self, goal: NDArray[np.float64], reached: bool) -> None:
        """Show the robot as it is now.

        Args:
            goal: Position of the goal in the world frame. m ``(3,)``
            reached: Whether it is reached.

        Raises:
            WindowClosed: The user closed the window.
        """
        if not self._window.show(goal, reached):
            raise WindowClosed


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
        accept_interface: Run a policy that was trained for another interface anyway.
        clock: Clock of real time; the machine's own by default.

    Returns:
        The result.

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
    trained = None if policy is None else load_trained_policy(policy, task)
    name = task if trained is None else trained.task.name
    assert name is not None
    with choose_robot(driver, robot).make_env(name) as env:
        window = _window(env)
        warnings: tuple[str, ...] = ()
        if trained is not None:
            warnings = check_fit(trained, env, accept_interface=accept_interface)
        pace = Pace(env.robot_spec.control_period_ns, clock or MonotonicClock())
        shown = successes = 0
        with suppress(WindowClosed):
            while episodes is None or shown < episodes:
                start = episode_seed(seed, Stream.FINAL_EVALUATION, shown)
                successes += _show_episode(env, trained, window, pace, start)
                shown += 1
    return ViewResult(shown, successes, warnings)


def _window(env: GoalRobotEnv) -> Viewable:
    spec = env.robot_spec
    if spec.physical:
        raise UserError(f"{spec.name} is physical and view would move it; use a simulated robot")
    if not isinstance(env.driver, Viewable):
        raise UserError(f"driver {spec.name} opens no window; use driver mujoco")
    return env.driver


def _show_episode(
    env: GoalRobotEnv, trained: TrainedPolicy | None, window: Viewable, pace: Pace, seed: int
) -> bool:
    """Show one episode; return whether it ended at the goal.

    Raises:
        WindowClosed: The user closed the window.
    """
    shown = WindowObserver(window, pace)
    if trained is None:
        return _show_start(env, shown, seed)
    outcome = EpisodeOutcome()
    run_episode(
        env,
        PolicyActor(trained.policy),
        outcome,
        seed=seed,
        ticks=env.episode_ticks,
        observers=[shown],
    )
    return outcome.success


def _show_start(env: GoalRobotEnv, shown: WindowObserver, seed: int) -> bool:
    """Show a robot that holds still at the start of an episode, for as long as one lasts."""
    observation, _ = env.reset(seed=seed)
    goal = observation["desired_goal"]
    reached = env.task.is_success(observation["achieved_goal"], goal)
    env.hold()
    shown.show(goal, reached)
    for _ in range(env.episode_ticks):
        shown.wait()
        env.driver.advance()  # without a command the tick is held
        shown.show(goal, reached)
    return bool(reached)
