"""The window's application, without a window: what it shows, when, and when it refuses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from drivers import SimulatedClock
from drivers.mujoco import MujocoDriver
from iher_robot.config.robot import choose_robot
from iher_robot.errors import UserError
from iher_robot.evaluation.evaluate import evaluate
from iher_robot.evaluation.policy_file import PolicyFile, save_policy
from iher_robot.evaluation.view import Pace, view
from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.goal_model import Shapes
from iher_robot.learning.policy import Policy

PERIOD_NS = 40_000_000


class Window:
    """Stands in for the window of every driver; closed by a person after some pictures."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.reached: list[bool] = []
        self.places: list[np.ndarray] = []
        self.ticks: list[int] = []
        self.closed_after = 10**9
        window = self

        def show(driver: MujocoDriver, goal: np.ndarray, reached: bool) -> bool:
            assert goal.shape == (3,)
            window.reached.append(reached)
            state = driver.read()
            window.places.append(state.ee_pos)
            window.ticks.append(state.seq)
            return len(window.reached) < window.closed_after

        monkeypatch.setattr(MujocoDriver, "show", show)


@pytest.fixture
def window(monkeypatch: pytest.MonkeyPatch) -> Window:
    monkeypatch.setenv("DISPLAY", ":0")
    return Window(monkeypatch)


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    """A policy for Reach that has learned nothing."""
    with choose_robot("mujoco", None).make_env("reach") as env:
        shapes = Shapes(env.task.layout.obs_dim, env.task.goal_dim, 4, 50)
        generator, device = torch.Generator().manual_seed(0), torch.device("cpu")
        made = Policy.from_config(shapes, LearnerConfig(), generator=generator, device=device)
        file = PolicyFile(policy=made.snapshot(), trained={}, **env.policy_interface())
    save_policy(tmp_path / "policy.pt", file)
    return tmp_path / "policy.pt"


def test_without_a_display_films_are_the_alternative(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(UserError, match=r"no display.*iher-robot evaluate --video"):
        view(task="push")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "no task given; .*--task.*--policy"),
        ({"task": "push", "episodes": 0}, "episodes is 0, allowed: 1 or more"),
        ({"task": "push", "seed": -1}, "seed is -1, allowed: 0 or more"),
    ],
)
def test_bad_input_is_refused(window: Window, options: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        view(**options)
    assert not window.reached


def test_without_a_policy_the_robot_holds_still_in_real_time(window: Window) -> None:
    clock = SimulatedClock()

    result = view(task="push", episodes=2, clock=clock)

    assert (result.episodes, result.successes) == (2, 0)
    assert len(window.reached) == 2 * 51  # the start, and after each tick
    assert clock.now_ns() == 2 * 50 * PERIOD_NS
    assert np.diff(window.ticks[:51]).tolist() == [1] * 50, "held, but not frozen"
    moved = np.linalg.norm(np.diff(window.places[:51], axis=0), axis=1).sum()
    assert moved < 0.005


def test_a_policy_acts_as_in_an_evaluation_of_the_same_seed(window: Window, policy: Path) -> None:
    result = view(policy=policy, episodes=8, seed=3, clock=SimulatedClock())

    assert result.successes == evaluate(policy, episodes=8, seed=3).successes
    assert result.successes == sum(window.reached[50::51])
    moved = np.linalg.norm(np.diff(window.places[:51], axis=0), axis=1).sum()
    assert moved > 0.02


def test_closing_the_window_ends_it(window: Window) -> None:
    window.closed_after = 60
    result = view(task="reach", clock=SimulatedClock())
    assert (result.episodes, len(window.reached)) == (1, 60)


def test_lost_time_is_not_caught_up_in_a_hurry() -> None:
    clock = SimulatedClock()
    pace = Pace(PERIOD_NS, clock)
    pace.wait()
    assert clock.now_ns() == PERIOD_NS
    clock.advance_ns(10 * PERIOD_NS)
    pace.wait()
    assert clock.now_ns() == 11 * PERIOD_NS, "late: at once"
    pace.wait()
    assert clock.now_ns() == 12 * PERIOD_NS, "and then at the pace of before"
