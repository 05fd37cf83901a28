"""Films: frames in, an mp4 file out."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium as gym

from iher_robot.errors import UserError

FRAMES_PER_SECOND = 25


@contextmanager
def film(path: Path) -> Iterator[Callable[[gym.Env[Any, Any]], None]]:
    """Write an mp4 file, a frame each time the function is called that this gives.

    Args:
        path: The file to write; replaced if it exists.

    Yields:
        Takes a picture of an environment whose ``render_mode`` is ``"rgb_array"``.

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
    if "MUJOCO_GL" not in os.environ and "DISPLAY" not in os.environ:
        raise UserError(
            "filming without a display needs a renderer: set MUJOCO_GL=egl, or MUJOCO_GL=osmesa "
            "(Debian packages libegl1, or libosmesa6)"
        )
    try:
        import imageio.v2 as imageio
        import imageio_ffmpeg  # noqa: F401 (imageio finds it by itself, too late to say so)
    except ImportError as error:
        raise UserError(
            "filming needs more packages: pip install imageio imageio-ffmpeg (the extra 'video'), "
            "or leave out --video"
        ) from error
    writer: Any  # imageio's annotations leave out what its writers can do
    with imageio.get_writer(path, fps=FRAMES_PER_SECOND, macro_block_size=16) as writer:

        def take(env: gym.Env[Any, Any]) -> None:
            writer.append_data(env.render())

        yield take
