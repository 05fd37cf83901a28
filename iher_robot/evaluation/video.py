"""Film of episodes: an mp4 file, with a mark while the goal is reached."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from drivers.rendering import RENDERERS
from iher_robot.config.robot import ChosenRobot
from iher_robot.errors import UserError
from iher_robot.rollout.observer import EpisodeEnv, EpisodeObserver, EpisodeStart, Transition

FRAMES_PER_SECOND = 25
_LAST_FRAME_S = 0.6
_DARK_GREEN = (0, 90, 30)  # stands out from the light green around Fetch's table
_WHITE = (255, 255, 255)
_BORDER_PIXELS = 8
_FONT_PIXELS = 24
_WORDS = "goal reached"

Picture = NDArray[np.uint8]


class Film(EpisodeObserver):
    """Films the episodes of an environment whose ``render_mode`` is ``"rgb_array"``.

    Args:
        path: The file.
        writer: Of imageio, whose annotations leave out what its writers can do.
    """

    def __init__(self, path: Path, writer: Any) -> None:
        self._path = path
        self._writer = writer
        self._env: EpisodeEnv | None = None
        self._last: Picture | None = None

    def start(self, start: EpisodeStart) -> None:
        """Add the picture of the start."""
        self._env = start.env
        self._take(reached=False)

    def after_tick(self, transition: Transition) -> None:
        """Add the picture after a tick."""
        self._take(reached=transition.success)

    def end(self, error: BaseException | None) -> None:
        """Show the last picture for a while: it says how the episode ended."""
        if error is None and self._last is not None:
            for _ in range(round(_LAST_FRAME_S * FRAMES_PER_SECOND)):
                self._append(self._last)

    def _take(self, *, reached: bool) -> None:
        assert self._env is not None, "start comes first"
        picture = np.asarray(self._env.render(), dtype=np.uint8)
        self._append(draw_reached(picture) if reached else picture)

    def _append(self, picture: Picture) -> None:
        with _writing(self._path):
            self._writer.append_data(picture)
        self._last = picture


@contextmanager
def film(path: Path) -> Iterator[Film]:
    """Write an mp4 file.

    Args:
        path: The file to write; replaced if it exists.

    Yields:
        The film.

    Raises:
        UserError: The extra ``video`` is not installed, nothing can be rendered here, or the
            file cannot be written.
    """
    if path.suffix != ".mp4":
        raise UserError(f"video file is {path}, allowed: a name that ends in .mp4")
    if not path.parent.is_dir():
        raise UserError(
            f"video file is {path}, but there is no folder {path.parent}; make it first"
        )
    require_film_packages()
    import imageio.v2 as imageio

    with _writing(path):
        writer: Any = imageio.get_writer(path, fps=FRAMES_PER_SECOND, macro_block_size=16)
    try:
        yield Film(path, writer)
    finally:
        with _writing(path):
            writer.close()


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Turn an error of writing the film into a sentence; other errors pass."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error).partition("\n")[0]  # then ffmpeg's command follows
        raise UserError(f"cannot write video file {path}: {reason}") from error


def require_film_packages() -> None:
    """Check that renderer and packages of films are installed, without drawing a frame.

    Raises:
        UserError: There is no renderer, or the extra ``video`` is not installed.
    """
    if "MUJOCO_GL" not in os.environ and "DISPLAY" not in os.environ:
        raise UserError(f"filming without a display needs a renderer: set MUJOCO_GL to {RENDERERS}")
    try:
        import mujoco  # noqa: F401 (it loads what MUJOCO_GL names)
    except (AttributeError, ImportError, RuntimeError) as error:  # the first is PyOpenGL's way
        raise UserError(
            f"MUJOCO_GL is {os.environ.get('MUJOCO_GL')!r}, which MuJoCo cannot load here; "
            f"allowed: {RENDERERS}"
        ) from error
    try:
        import imageio.v2  # noqa: F401
        import imageio_ffmpeg  # noqa: F401 (imageio finds it by itself, too late to say so)
    except ImportError as error:
        raise UserError(
            "filming needs more packages: pip install imageio imageio-ffmpeg (the extra 'video'), "
            "or leave out --video"
        ) from error


def require_film(robot: ChosenRobot, task: str) -> None:
    """Draw one picture, so that a run that cannot be filmed fails before it begins.

    Args:
        robot: The robot to film, simulated.
        task: Name of the task.

    Raises:
        UserError: The robot is physical or renders nothing, or films cannot be made here.
        CannotRender: Nothing draws here.
    """
    require_film_packages()
    with robot.make_env(task, "rgb_array") as env:
        if env.robot_spec.physical:
            raise UserError(
                f"--video films in simulation, and {env.robot_spec.name} is physical; leave it out"
            )
        env.reset(seed=0)
        env.render()


def draw_reached(picture: Picture) -> Picture:
    """Draw a green border and the words "goal reached" into a copy of a picture.

    Args:
        picture: RGB. ``(height, width, 3)``

    Returns:
        RGB. ``(height, width, 3)``
    """
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    corner = (image.width - 1, image.height - 1)
    draw.rectangle(((0, 0), corner), outline=_DARK_GREEN, width=_BORDER_PIXELS)
    font = ImageFont.load_default(_FONT_PIXELS)
    place = (2 * _BORDER_PIXELS, _BORDER_PIXELS)
    right, bottom = draw.textbbox(place, _WORDS, font=font)[2:]
    draw.rectangle(((0, 0), (right + place[0], bottom + place[1])), fill=_DARK_GREEN)
    draw.text(place, _WORDS, font=font, fill=_WHITE)
    return np.asarray(image, dtype=np.uint8)
