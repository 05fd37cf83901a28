"""Gymnasium goal environment: a driver, a task and a controller."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from drivers import (
    InvalidCommand,
    LeaseRefused,
    LinkLost,
    Refusal,
    Renderable,
    ResetOutcome,
    RobotDriver,
    RobotSpec,
    RobotState,
    StaleState,
    make_driver,
)
from iher_robot.env.controller import Controller, make_controller
from iher_robot.env.operator import AskHuman, reset_with_help
from iher_robot.env.tick import InvalidTicks, Tick, evaluate_tick
from iher_robot.errors import NoSolution, UserError
from tasks import GoalTask, make_task

Observation = dict[str, Any]  # gymnasium's type of a Dict space
Info = dict[str, Any]

_IMAGE_SIZE = (640, 480)
_GATE_CLOSED = (Refusal.DISARMED, Refusal.LATCHED)
_CONNECTION_ENDED = (LinkLost, LeaseRefused)


class ResetFailed(UserError):
    """The robot could not be brought to the start of an episode."""


class EpisodeAborted(RuntimeError):
    """An episode ended early; the robot is held and disarmed. `reset` starts the next.

    Attributes:
        ticks: Ticks of the robot in the last step, at least 1.
    """

    def __init__(self, message: str = "", ticks: int = 1) -> None:
        super().__init__(message)
        self.ticks = ticks


class LinkTooSlow(EpisodeAborted):
    """Too many ticks were invalid, most of them missed or late."""


class GoalRobotEnv(gym.Env[Observation, NDArray[np.floating]]):
    """A robot with a goal. One step is exactly one control tick.

    The robot is armed by `reset`, for one episode; `close`, leaving a ``with`` block, an
    aborted episode and any error leave it held and disarmed. It is opened by the first
    `reset`, so that the spaces are known without a connection.

    Entries of a step's `info`:

    - ``is_success``: 1.0 if the goal is reached, else 0.0.
    - ``tick``: The control tick as a `Tick`, with the robot's tick counter; the following entries
      are parts of it.
    - ``action_applied``: The applied action, the one to learn from. It equals the requested one,
      clipped to [-1, 1], where nothing else was clipped.
    - ``tick_valid``: Whether the tick may be used for learning. A tick that was held, dropped or
      late is not, but is charged to the budget (``ticks``).
    - ``clipped``: Why the robot clipped the command, or ``"controller"`` where the controller
      could not request the full action.
    - ``refusal``: Why the command was refused, ``"no_solution"`` where the controller found
      none, or None.

    An external stop, a lost link, or more invalid ticks than allowed end the episode with
    `EpisodeAborted`. A robot whose link or lease is lost is disconnected; the next `reset`
    reconnects.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 25}  # noqa: RUF012

    def __init__(
        self,
        driver: RobotDriver,
        task: GoalTask,
        controller: Controller | None = None,
        render_mode: str | None = None,
        max_invalid_ticks: int = 5,
        ask_human: AskHuman | None = None,
    ) -> None:
        """Create the environment of a task on a robot.

        Args:
            driver: The robot, open or not.
            task: The task; it is bound to the robot here.
            controller: Converts actions to commands; by default the one for the commands that
                the robot accepts.
            render_mode: ``"rgb_array"`` or None.
            max_invalid_ticks: An episode aborts after more invalid ticks than this.
            ask_human: Called with what a person has to do; returns when it is done and hands
                are clear. Without it a reset that needs a person is an error.

        Raises:
            UserError: If the robot does not accept the controller's commands, or cannot render.
        """
        self.driver = driver
        self.task = task.bind(driver.spec)
        self.controller: Controller = (
            make_controller(driver.spec, task.blocks_gripper) if controller is None else controller
        )
        self._require_command_kind()
        if render_mode is not None and not isinstance(driver, Renderable):
            raise UserError(f"driver {driver.spec.name} renders no images; use render_mode=None")
        self.render_mode = render_mode
        self._max_invalid_ticks = max_invalid_ticks
        self.ask_human = ask_human
        goal = spaces.Box(-np.inf, np.inf, (self.task.goal_dim,), np.float64)
        observation = spaces.Box(-np.inf, np.inf, (self.task.layout.obs_dim,), np.float64)
        self.observation_space: spaces.Dict = spaces.Dict(
            {"observation": observation, "achieved_goal": goal, "desired_goal": goal}
        )
        self.action_space = spaces.Box(-1.0, 1.0, (driver.spec.action.dim,), np.float32)
        self.episode_ticks = self.task.episode_ticks
        self._goal = np.zeros(self.task.goal_dim)
        self._state: RobotState | None = None
        self._invalid = InvalidTicks(max_invalid_ticks)
        self._held_because = ""

    @property
    def robot_spec(self) -> RobotSpec:
        """Specification of the robot; `spec` is Gymnasium's specification of the environment."""
        return self.driver.spec

    @property
    def state(self) -> RobotState | None:
        """State at the end of the last reset or step; None while held."""
        return self._state

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """Bring the robot to a new start, draw a goal from the measured start, and arm.

        Args:
            seed: Seed of starts and goals.
            options: Not used.

        Returns:
            The observation and an empty info.

        Raises:
            ResetFailed: If the robot cannot reach it, or needs a person and none is present.
            FaultLatched: If the robot is stopped.
            LinkLost: If a remote robot does not answer; it is disconnected.
            LeaseRefused: If another client holds its lease; it is disconnected.
        """
        try:
            super().reset(seed=seed, options=options)
            return self._begin_episode(), {}
        except _CONNECTION_ENDED as error:
            self._after(error, self.close)
            raise
        except BaseException as error:
            self.hold(after=error)
            raise

    def step(self, action: NDArray[np.floating]) -> tuple[Observation, float, bool, bool, Info]:
        """Run one control tick.

        Args:
            action: dx, dy, dz, gripper, clipped to [-1, 1]. ``(4,)``

        Returns:
            Observation, reward, terminated and truncated (always False: the registered ids add a
            time limit) and info.

        Raises:
            ValueError: If the action has the wrong shape.
            InvalidCommand: If the action is not finite.
            EpisodeAborted: If the robot was stopped, disarmed or lost, or too many ticks were
                invalid. The last tick is charged.
            LinkTooSlow: If most of these ticks were missed or late.
        """
        try:
            after, tick = self._run_tick(action)
            self._abort_if_lost(tick)
            observation = self._observe(self.task.observation(after))
            achieved = observation["achieved_goal"]
            reward = float(self.task.goal_model.compute_reward(achieved, self._goal))
            success = float(self.task.is_success(achieved, self._goal))
            return observation, reward, False, False, {"is_success": success} | tick.info()
        except _CONNECTION_ENDED as error:
            aborted = EpisodeAborted(f"episode on {self.robot_spec.name} aborted: {error}")
            self._after(aborted, self.close)
            raise aborted from error
        except BaseException as error:  # also errors of task and caller: no next tick would come
            self.hold(after=error)
            raise

    def compute_reward(
        self,
        achieved_goal: NDArray[np.floating],
        desired_goal: NDArray[np.floating],
        info: object,  # noqa: ARG002 - Gymnasium's interface
    ) -> NDArray[np.floating]:
        """Return the sparse reward; leading axes are a batch.

        Args:
            achieved_goal: ``(..., goal_dim)``
            desired_goal: ``(..., goal_dim)``
            info: Not used.

        Returns:
            0 within the threshold, else -1. ``(...,)``
        """
        return self.task.goal_model.compute_reward(achieved_goal, desired_goal)

    def policy_interface(self) -> dict[str, Any]:
        """Return the interface that a policy file stores, as plain JSON data."""
        spec = self.robot_spec
        return {
            "task": self.task.name,
            "layout": self.task.layout.to_dict(),
            "layout_digest": self.task.layout.digest(),
            "interface_digest": spec.interface_digest,
            "body_digest": spec.body_digest,
            "spec": spec.to_dict(),
            "controller": dict(self.controller.settings),
        }

    def render(self) -> NDArray[np.uint8] | None:
        """Return an image with the goal, green once reached; None without a render mode."""
        if self.render_mode is None:
            return None
        assert isinstance(self.driver, Renderable)
        reached = False
        if self._state is not None:
            achieved = self.task.goal_model.achieved_goal(self.task.observation(self._state))
            reached = self.task.is_success(achieved, self._goal)
        return self.driver.render(*_IMAGE_SIZE, goal=self._goal, reached=reached)

    def hold(self, after: BaseException | None = None) -> None:
        """Hold and disarm, until the next `reset`.

        Args:
            after: The error being raised, if any; if holding fails too, it gets a note and is
                still the one raised.
        """
        self._state = None
        if after is None:
            self.driver.disarm()
        else:
            self._after(after, self.driver.disarm)

    def close(self) -> None:
        """Hold, disarm and disconnect."""
        self._state = None
        self.driver.close()

    def _after(self, error: BaseException, cleanup: Callable[[], None]) -> None:
        try:
            cleanup()
        except Exception as failure:  # noqa: BLE001 - the first error is raised
            error.add_note(f"{self.robot_spec.name} could not be held either: {failure!r}")

    def _require_command_kind(self) -> None:
        if self.controller.kind not in self.robot_spec.command_kinds:
            raise UserError(
                f"the controller makes {self.controller.kind!r} commands, "
                f"{self.robot_spec.name} accepts: {', '.join(self.robot_spec.command_kinds)}"
            )

    def _begin_episode(self) -> Observation:
        if not self.driver.is_open:
            self.driver.open()
        self.hold()
        self._bring_to_start()
        self._invalid = InvalidTicks(self._max_invalid_ticks)
        self._held_because = ""
        self.driver.arm()
        self._state = self.driver.read()
        observation = self.task.observation(self._state)
        self._goal = self.task.goal_model.sample_goal(self.np_random, observation[None])[0]
        return self._observe(observation)

    def _run_tick(self, action: NDArray[np.floating]) -> tuple[RobotState, Tick]:
        before = self._state
        if before is None:
            raise gym.error.ResetNeeded("step before reset; call reset first")
        if np.shape(action) != self.action_space.shape:
            raise ValueError(
                f"action has shape {np.shape(action)}, allowed: {self.action_space.shape}"
            )
        if not np.isfinite(action).all():  # before clipping: infinity would become 1
            raise InvalidCommand(
                f"action is {np.asarray(action).tolist()}, allowed: finite numbers"
            )
        assert isinstance(self.action_space, spaces.Box)
        requested = np.clip(action, self.action_space.low, self.action_space.high)
        acceptance = None
        try:
            acceptance = self.driver.command(self.controller.command(requested, before))
            self._held_because = ""
        except NoSolution as error:
            self._held_because = str(error)  # no command in this tick: the robot holds
        self.driver.advance()
        after = self._read_or_keep(before)
        self._state = after
        return after, evaluate_tick(requested, before, after, acceptance, self.controller)

    def _bring_to_start(self) -> None:
        request = self.task.reset_request(self.np_random)
        # From a copy: starts and goals stay those of the reference.
        noise_seed = int(copy.deepcopy(self.np_random).integers(2**32))
        request = dataclasses.replace(request, seed=noise_seed)
        result = reset_with_help(self.driver, request, self.ask_human)
        if result.outcome is not ResetOutcome.DONE:
            raise ResetFailed(
                f"reset of {self.robot_spec.name} ended as {result.outcome}: {result.message}"
            )

    def _read_or_keep(self, before: RobotState) -> RobotState:
        try:
            return self.driver.read()
        except StaleState:
            return before  # a dropped tick: the unchanged sequence shows it

    def _observe(self, observation: NDArray[np.float64]) -> Observation:
        return {
            "observation": observation,
            "achieved_goal": self.task.goal_model.achieved_goal(observation).copy(),
            "desired_goal": self._goal.copy(),
        }

    def _abort_if_lost(self, tick: Tick) -> None:
        self._invalid.add(tick)
        kind = EpisodeAborted
        if tick.acceptance is not None and tick.acceptance.refusal in _GATE_CLOSED:
            reason = tick.acceptance.message
        elif not self.driver.is_armed:
            because = self.driver.disarmed_because
            reason = "the robot was disarmed during the tick" + ": " * bool(because) + because
        elif self._invalid.too_many:
            reason = f"{self._invalid.count} invalid ticks, allowed: {self._invalid.allowed}"
            reason += "; " * bool(self._held_because) + self._held_because
            if self._invalid.mostly_late:
                kind = LinkTooSlow
                reason += (
                    f"; {self._invalid.late} of these {self._invalid.count} were late or missed: "
                    "the link is too slow, measure it with: iher-robot doctor"
                )
        else:
            return
        raise kind(f"episode on {self.robot_spec.name} aborted: {reason}", tick.elapsed)


def make_env(
    task_name: str,
    driver_name: str = "mujoco",
    render_mode: str | None = None,
    ask_human: AskHuman | None = None,
    **driver_options: Any,
) -> GoalRobotEnv:
    """Make the environment of a task on a driver.

    Args:
        task_name: Name of the task.
        driver_name: Name of the driver.
        render_mode: ``"rgb_array"`` or None.
        ask_human: As for `GoalRobotEnv`.
        driver_options: Options of the driver; the scene is the task's by default.

    Returns:
        The environment, not yet connected.

    Raises:
        UnknownTask: If there is no such task.
        UnknownDriver: If there is no such driver.
    """
    task = make_task(task_name)
    driver = make_driver(driver_name, **({"scene": task.scene} | driver_options))
    return GoalRobotEnv(driver, task, render_mode=render_mode, ask_human=ask_human)
