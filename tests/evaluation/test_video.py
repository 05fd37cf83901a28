"""Films: every frame is there, and success can be seen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.mujoco import MujocoDriver
from iher_robot.env.goal_env import make_env
from iher_robot.errors import UserError
from iher_robot.evaluation.video import FRAMES_PER_SECOND, draw_reached, film, require_film_packages
from iher_robot.rollout.observer import EpisodeStart, Transition

imageio = pytest.importorskip("imageio.v2")


class Stage:
    """Renders one grey more at every call."""

    def __init__(self) -> None:
        self.pictures = 0

    def render(self) -> Any:
        self.pictures += 1
        return np.full((240, 320, 3), 100 + self.pictures, np.uint8)


@pytest.fixture(autouse=True)
def _renderer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "egl")


def greenish(picture: NDArray[np.uint8]) -> NDArray[np.bool_]:
    light = picture.astype(int)
    green: NDArray[np.bool_] = light[..., 1] > light[..., [0, 2]].max(axis=-1) + 30
    return green


def test_success_is_a_green_border_with_white_words() -> None:
    picture = Stage().render()
    before = picture.copy()

    drawn = draw_reached(picture)

    assert (picture == before).all()
    assert drawn.shape == picture.shape
    green = greenish(drawn)
    for side in (green[0], green[-1], green[:, 0], green[:, -1]):
        assert side.all()
    assert (drawn == 255).all(axis=-1).any()
    assert (drawn[60:-10, 10:-10] == before[60:-10, 10:-10]).all(), "the scene itself is left alone"


def test_a_film_has_every_frame_and_shows_success_from_its_moment(tmp_path: Path) -> None:
    path, stage = tmp_path / "film.mp4", Stage()
    with film(path) as shots:
        shots.start(EpisodeStart(stage, {}, 0))  # type: ignore[arg-type]
        for reached in (False, True):
            shots.after_tick(Transition({}, np.zeros(4), {}, {"is_success": reached}))
        shots.end(None)

    frames = list(imageio.get_reader(path).iter_data())
    assert len(frames) == 3 + round(0.6 * FRAMES_PER_SECOND)
    assert [bool(greenish(frame)[2].mean() > 0.9) for frame in frames] == [False] * 2 + [True] * 16


def test_a_film_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    path = tmp_path / "film.mp4"
    path.mkdir()

    def take_until_ffmpeg_has_failed() -> None:
        with film(path) as shots:
            shots.start(EpisodeStart(Stage(), {}, 0))  # type: ignore[arg-type]
            for _ in range(1000):
                shots.after_tick(Transition({}, np.zeros(4), {}, {"is_success": False}))

    with pytest.raises(UserError, match=r"cannot write video file .*film\.mp4"):
        take_until_ffmpeg_has_failed()


def test_an_error_while_filming_is_not_taken_for_one_of_the_film(tmp_path: Path) -> None:
    with pytest.raises(ConnectionError), film(tmp_path / "film.mp4"):
        raise ConnectionError("the robot is gone")


def test_the_environment_tells_the_camera_of_its_success(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[NDArray[np.float64], bool]] = []

    def render(
        self: MujocoDriver, width: int, height: int, goal: NDArray[np.float64], reached: bool
    ) -> NDArray[np.uint8]:
        seen.append((goal, reached))
        return np.zeros((height, width, 3), np.uint8)

    monkeypatch.setattr(MujocoDriver, "render", render)
    with make_env("reach", render_mode="rgb_array") as env:
        observation, _ = env.reset(seed=1)
        goal = observation["desired_goal"]
        successes = []
        for _ in range(env.episode_ticks):
            action = np.zeros(4, np.float32)
            action[:3] = np.clip(10 * (goal - observation["achieved_goal"]), -1, 1)
            observation, _, _, _, info = env.step(action)
            env.render()
            successes.append(bool(info["is_success"]))

    assert [reached for _, reached in seen] == successes
    assert set(successes) == {False, True}  # else the comparison shows nothing
    assert all((marked == goal).all() for marked, _ in seen)


def test_without_display_and_renderer_the_way_out_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("MUJOCO_GL")
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(UserError, match=r"MUJOCO_GL to egl.*libegl1"):
        require_film_packages()
