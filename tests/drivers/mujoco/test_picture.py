"""Rendering, in a separate process: MuJoCo reads MUJOCO_GL once, when it is imported."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

NO_GRAPHICS = 77

SCRIPT = f"""
import sys
import numpy as np
from drivers import ResetRequest
from drivers.mujoco import MujocoDriver
from drivers.rendering import CannotRender

driver = MujocoDriver("pick_and_place")
driver.open()
driver.reset(ResetRequest())
try:
    driver.render(64, 48)
except CannotRender:
    sys.exit({NO_GRAPHICS})
before = driver.snapshot()
goal = np.array([1.4, 0.75, 0.7])
plain, marked = driver.render(320, 240), driver.render(320, 240, goal)
reached = driver.render(320, 240, goal, reached=True)
after = driver.snapshot()
assert plain.shape == (240, 320, 3) and plain.dtype == np.uint8
assert plain.std() > 10.0, "an empty picture"
for name in ("qpos", "qvel", "site_xpos", "xpos", "mocap_pos", "qacc_warmstart"):
    assert (getattr(before, name) == getattr(after, name)).all(), name

def red(picture):
    light = picture.astype(int)
    return ((light[..., 0] > 120) & (light[..., 1] < 80) & (light[..., 2] < 80)).sum()

assert red(plain) == 0, "the model's own mark of a goal must be hidden"
assert 5 < red(marked) < 500, red(marked)
assert red(reached) == 0, "the mark of a reached goal must not be red"
changed = (reached != marked).any(axis=-1)
assert 5 < changed.sum() < 500
colour = reached[changed].astype(int).mean(axis=0)
assert colour[1] > colour[0] + 60 and colour[1] > colour[2] + 60, colour
driver.close()
"""


def test_a_picture_marks_the_goal_and_leaves_the_simulation_alone() -> None:
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env={"MUJOCO_GL": "egl"} | os.environ,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode == NO_GRAPHICS:
        pytest.skip("no offscreen graphics here")
    assert done.returncode == 0, done.stderr
