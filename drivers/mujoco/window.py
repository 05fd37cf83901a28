"""Window that shows the simulation: MuJoCo's interactive viewer."""

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
    """The part of `mujoco.viewer.Handle` that is used here."""

    user_scn: mujoco.MjvScene
    cam: mujoco.MjvCamera

    def lock(self) -> AbstractContextManager[object]:
        """Return a context in which the window does not draw."""
        ...

    def sync(self) -> None:
        """Draw the changes."""
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
        CannotRender: If no window can be opened.
    """
    try:
        import glfw
        from mujoco import viewer  # not at the top: it loads a window system

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if not glfw.init():  # otherwise the viewer ends the process
                raise CannotRender("the display named by DISPLAY does not answer; correct DISPLAY")
        handle: Handle = viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
    except (ImportError, RuntimeError, mujoco.FatalError) as error:
        raise CannotRender(f"MuJoCo's viewer opens no window here: {in_a_line(error)}") from error
    return handle


_CLOSING_S = 5.0

Launch = Callable[[mujoco.MjModel, mujoco.MjData], Handle]


class Window:
    """Shows a copy of model and state, so that user input in the window changes no simulation."""

    def __init__(self, model: mujoco.MjModel, launch: Launch = launch_passive) -> None:
        """Open the window.

        Args:
            model: The compiled scene.
            launch: Opens MuJoCo's viewer.

        Raises:
            CannotRender: If no window can be opened.
        """
        self._model = copy.copy(model)
        self._shown = mujoco.MjData(self._model)
        before = set(threading.enumerate())
        self._handle = launch(self._model, self._shown)
        self._threads = set(threading.enumerate()) - before
        with self._handle.lock():
            look(self._handle.cam)

    def show(self, data: mujoco.MjData, goal: Goal, reached: bool) -> bool:
        """Update the window, leaving the simulation unchanged to the last bit.

        Args:
            data: The simulation.
            goal: Position to mark, world frame, m. ``(3,)``
            reached: Whether the goal is reached.

        Returns:
            Whether the window is still open.
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
        """Close the window, and wait for the end of its thread.

        A program that ends while the viewer's thread cleans up ends with a segmentation fault.
        """
        self._handle.close()
        for thread in self._threads:
            thread.join(_CLOSING_S)
