"""The episode loop and its observers: order of hooks, charging, and how an episode ends."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from iher_robot.env.goal_env import EpisodeAborted, Info, Observation
from iher_robot.rollout.episode import run_episode
from iher_robot.rollout.observer import Action, EpisodeObserver, EpisodeStart, Transition
from iher_robot.rollout.recorder import EpisodeOutcome
from tests.random_actor import RandomActor

HOOKS = ("start", "before_tick", "after_tick", "abort", "end")


class ScriptedEnv:
    """Answers each step from a list: the ticks that it took, or an error."""

    def __init__(self, *steps: int | Exception) -> None:
        self._steps = list(steps)
        self.calls: list[str] = []
        self.hold_error: Exception | None = None

    def reset(self, *, seed: int) -> tuple[Observation, Info]:
        self.calls.append("reset")
        return {"observation": np.zeros(1)}, {}

    def step(self, action: Action, /) -> tuple[Observation, float, bool, bool, Info]:
        self.calls.append("step")
        step = self._steps.pop(0)
        if isinstance(step, Exception):
            raise step
        return {"observation": np.ones(1)}, 0.0, False, False, {"is_success": 1.0, "ticks": step}

    def hold(self, after: BaseException | None = None) -> None:
        self.calls.append("hold")
        if self.hold_error is not None:
            raise self.hold_error

    def render(self) -> None:
        pass


class Noting(EpisodeObserver):
    """Notes its hooks in the environment's calls, and raises in one of them."""

    def __init__(self, env: ScriptedEnv, name: str, failing: str = "") -> None:
        self._env = env
        self._name = name
        self._failing = failing
        self.ended_by: BaseException | None = None

    def _note(self, hook: str) -> None:
        self._env.calls.append(f"{self._name}.{hook}")
        if hook == self._failing:
            raise RuntimeError(hook)

    def start(self, start: EpisodeStart) -> None:
        self._note("start")

    def before_tick(self, observation: Observation, action: Action) -> None:
        self._note("before_tick")

    def after_tick(self, transition: Transition) -> None:
        self._note("after_tick")

    def abort(self, error: EpisodeAborted) -> None:
        self._note("abort")

    def end(self, error: BaseException | None) -> None:
        self.ended_by = error
        self._note("end")


def run(env: ScriptedEnv, *observers: EpisodeObserver, ticks: int = 2) -> EpisodeOutcome:
    outcome = EpisodeOutcome()
    run_episode(env, RandomActor(0), outcome, seed=0, ticks=ticks, observers=observers)
    return outcome


def test_hooks_are_called_in_order_and_the_robot_is_held_before_the_end() -> None:
    env = ScriptedEnv(1, 1)
    outcome = run(env, Noting(env, "a"), Noting(env, "b"))
    tick = ["a.before_tick", "b.before_tick", "step", "a.after_tick", "b.after_tick"]
    assert env.calls == ["reset", "a.start", "b.start", *tick, *tick, "hold", "a.end", "b.end"]
    assert (outcome.ticks, outcome.success, outcome.aborted) == (2, True, "")


def test_ticks_that_passed_unseen_count_towards_the_length() -> None:
    assert run(ScriptedEnv(1, 3, 1), ticks=4).ticks == 4


def test_an_aborted_tick_is_charged_and_the_episode_fails() -> None:
    env = ScriptedEnv(1, EpisodeAborted("the robot was stopped", ticks=3))
    observer = Noting(env, "a")
    outcome = run(env, observer, ticks=9)
    assert (outcome.ticks, outcome.success) == (1 + 3, False)
    assert outcome.aborted == "the robot was stopped"
    assert env.calls[-3:] == ["a.abort", "hold", "a.end"]
    assert observer.ended_by is None, "the run goes on"


def test_an_abort_before_the_first_tick_is_not_charged() -> None:
    class Refuses(EpisodeObserver):
        def start(self, start: EpisodeStart) -> None:
            raise EpisodeAborted("not here", ticks=3)

    outcome = run(ScriptedEnv(), Refuses())
    assert (outcome.ticks, outcome.aborted) == (0, "not here")


@pytest.mark.parametrize("hook", HOOKS)
def test_every_observer_gets_its_end_whichever_hook_of_another_raises(hook: str) -> None:
    step: Any = EpisodeAborted() if hook == "abort" else 1
    env = ScriptedEnv(step)
    last = Noting(env, "b")
    with pytest.raises(RuntimeError, match=f"^{hook}$"):
        run(env, Noting(env, "a", failing=hook), last, ticks=1)
    assert env.calls[-3:] == ["hold", "a.end", "b.end"]
    assert isinstance(last.ended_by, RuntimeError)


def test_a_robot_that_cannot_be_held_is_the_error_of_the_end() -> None:
    env = ScriptedEnv(1)
    env.hold_error = ConnectionError("gone")
    observer = Noting(env, "a")
    with pytest.raises(ConnectionError, match="gone"):
        run(env, observer, ticks=1)
    assert observer.ended_by is env.hold_error
