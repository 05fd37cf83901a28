"""The goal mark and the window, on scenes without graphics."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
from contextlib import AbstractContextManager, nullcontext

import mujoco
import numpy as np
import pytest

from drivers import ResetRequest
from drivers.mujoco import MujocoDriver
from drivers.mujoco.view import mark_goal
from drivers.mujoco.window import Window
from drivers.rendering import Renderable, Viewable

GOAL = np.array([1.4, 0.75, 0.7])


class Handle:
    """MuJoCo's viewer without a window."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self.model, self.data = model, data
        self.user_scn = mujoco.MjvScene(model, maxgeom=4)
        self.cam = mujoco.MjvCamera()
        self.running = True
        self.drawn: list[list[tuple[bytes, bytes]]] = []

    def lock(self) -> AbstractContextManager[object]:
        return nullcontext()

    def sync(self) -> None:
        marks = [self.user_scn.geoms[index] for index in range(self.user_scn.ngeom)]
        self.drawn.append([(mark.pos.tobytes(), mark.rgba.tobytes()) for mark in marks])

    def is_running(self) -> bool:
        return self.running

    def close(self) -> None:
        self.running = False


@pytest.fixture
def data() -> mujoco.MjData:
    driver = MujocoDriver("push")
    driver.open()
    driver.reset(ResetRequest())
    return driver.snapshot()


def scene(model: mujoco.MjModel, size: int) -> mujoco.MjvScene:
    return mujoco.MjvScene(model, maxgeom=size)


def test_the_mark_is_where_the_goal_is_and_turns_from_red_to_green(data: mujoco.MjData) -> None:
    marked = scene(data.model, 4)
    mark_goal(marked, GOAL, False)
    mark_goal(marked, GOAL, True)

    assert marked.ngeom == 2
    red, green = (marked.geoms[index] for index in range(2))
    np.testing.assert_allclose((red.pos, green.pos), (GOAL, GOAL), atol=1e-6)
    assert red.rgba[0] > 2 * red.rgba[1]
    assert green.rgba[1] > 2 * green.rgba[0]


def test_no_goal_and_a_full_scene_get_no_mark(data: mujoco.MjData) -> None:
    marked = scene(data.model, 1)
    mark_goal(marked, None, False)
    assert marked.ngeom == 0
    mark_goal(marked, GOAL, False)
    mark_goal(marked, GOAL, True)
    assert marked.ngeom == 1


def test_a_window_shows_one_goal_and_the_state_as_it_is(data: mujoco.MjData) -> None:
    opened: list[Handle] = []

    def launch(model: mujoco.MjModel, shown: mujoco.MjData) -> Handle:
        opened.append(Handle(model, shown))
        return opened[0]

    window = Window(data.model, launch)
    before = data.qpos.copy()
    for reached in (False, True):
        data.qpos[0] += 0.01
        assert window.show(data, GOAL, reached)

    (handle,) = opened
    assert [len(marks) for marks in handle.drawn] == [1, 1], "the previous mark is removed"
    assert handle.drawn[0][0][1] != handle.drawn[1][0][1], "the colour changes"
    np.testing.assert_array_equal(handle.data.qpos, data.qpos)
    assert data.qpos[0] == pytest.approx(before[0] + 0.02)


def test_user_input_in_the_window_changes_no_simulation(data: mujoco.MjData) -> None:
    opened: list[Handle] = []

    def launch(model: mujoco.MjModel, shown: mujoco.MjData) -> Handle:
        opened.append(Handle(model, shown))
        return opened[0]

    window = Window(data.model, launch)
    gravity, qpos = data.model.opt.gravity.copy(), data.qpos.copy()
    opened[0].model.opt.gravity[:] = 0.0
    opened[0].data.qpos[:] = 1.0
    window.show(data, None, False)
    np.testing.assert_array_equal(data.model.opt.gravity, gravity)
    np.testing.assert_array_equal(data.qpos, qpos)
    opened[0].close()
    assert not window.show(data, None, False)


def test_the_simulated_robot_offers_pictures_and_a_window() -> None:
    driver = MujocoDriver("reach")
    assert isinstance(driver, Renderable)
    assert isinstance(driver, Viewable)


def test_closing_waits_for_the_viewers_own_thread(data: mujoco.MjData) -> None:
    release, gone = threading.Event(), threading.Event()

    def draw() -> None:
        release.wait(5.0)
        gone.set()

    class Threaded(Handle):
        def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
            super().__init__(model, data)
            threading.Thread(target=draw, daemon=True).start()

        def close(self) -> None:
            threading.Timer(0.1, release.set).start()

    Window(data.model, Threaded).close()
    assert gone.is_set()


@pytest.mark.skipif(shutil.which("xvfb-run") is None, reason="needs xvfb-run (Debian package xvfb)")
def test_the_real_viewer_opens_and_ends_without_a_crash() -> None:
    command = ["xvfb-run", "-a", sys.executable, "-m", "iher_robot", "view", "--task", "reach"]
    environment = {key: value for key, value in os.environ.items() if key != "MUJOCO_GL"}
    done = subprocess.run(
        [*command, "--episodes", "1"], capture_output=True, text=True, env=environment, check=False
    )
    if "opens no window here" in done.stderr:
        pytest.skip("no OpenGL on the virtual display")
    assert done.returncode == 0, done.stderr
    assert "1 episode shown" in done.stdout
