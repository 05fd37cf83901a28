"""A window on the simulation: MuJoCo's interactive viewer."""

from __future__ import annotations

import copy
import threading
import warnings
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Protocol

import mujoco

from drivers.mujoco.view import Goal, in_a_line, look, mark_goal, settled
from drivers.rendering import CannotRender


class Handle(Protocol):
    """What is used of `mujoco.viewer.Handle`."""

    user_scn: mujoco.MjvScene
    cam: mujoco.MjvCamera

    def lock(self) -> AbstractContextManager[object]:
        """Keep the window from drawing meanwhile."""
        ...

    def sync(self) -> None:
        """Draw what has changed."""
        ...

    def is_running(self) -> bool:
        """Return whether the window is open."""
        ...

    def close(self) -> None:
        """Close the window."""
        ...


def launch_passive(model: mujoco.MjModel, data: mujoco.MjData) -> Handle:
    """Open MuJoCo's interactive viewer without its panels.

    Raises:
        CannotRender: If no window opens here.
    """
    try:
        import glfw
        from mujoco import viewer  # only here: it loads a window system

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if not glfw.init():  # the viewer would end the whole process
                raise CannotRender("the display that DISPLAY names does not answer; set it right")
        handle: Handle = viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
    except (ImportError, RuntimeError, mujoco.FatalError) as error:
        raise CannotRender(f"MuJoCo's viewer opens no window here: {in_a_line(error)}") from error
    return handle


_CLOSING_S = 5.0

Launch = Callable[[mujoco.MjModel, mujoco.MjData], Handle]


class Window:
    """Shows a copy of model and state: nothing that a person does there reaches the simulation."""

    def __init__(self, model: mujoco.MjModel, launch: Launch = launch_passive) -> None:
        """Open the window.

        Args:
            model: The compiled scene.
            launch: Opens MuJoCo's viewer.

        Raises:
            CannotRender: If no window opens here.
        """
        self._model = copy.copy(model)
        self._shown = mujoco.MjData(self._model)
        before = set(threading.enumerate())
        self._handle = launch(self._model, self._shown)
        self._threads = set(threading.enumerate()) - before
        with self._handle.lock():
            look(self._handle.cam)

    def show(self, data: mujoco.MjData, goal: Goal, reached: bool) -> bool:
        """Bring the window up to date, leaving the simulation untouched to the last bit.

        Args:
            data: The simulation.
            goal: Marked, world frame, m. ``(3,)``
            reached: Whether the goal is reached.

        Returns:
            Whether the window is open still.
        """
        if not self._handle.is_running():
            return False
        with self._handle.lock():
            mujoco.mj_copyData(self._shown, self._model, settled(self._model, data))
            self._handle.user_scn.ngeom = 0
            mark_goal(self._handle.user_scn, goal, reached)
        self._handle.sync()
        return self._handle.is_running()

    def close(self) -> None:
        """Close the window, and wait until it is gone.

        The viewer draws in a thread of its own. A program that ended while it cleans up would
        end with a segmentation fault.
        """
        self._handle.close()
        for thread in self._threads:
            thread.join(_CLOSING_S)
